// SPDX-License-Identifier: Apache-2.0
#include "linear/worker_pool.hpp"

#include <chrono>

#include "linear/flush_subnormals.hpp"

namespace clba {
namespace {

constexpr std::chrono::microseconds spin_time(30);

// Waits for the condition, for spin_time at most.
template <class Condition>
void spin_until(const Condition& condition) {
    const auto end = std::chrono::steady_clock::now() + spin_time;
    while (!condition() && std::chrono::steady_clock::now() < end) {
    }
}

}  // namespace

WorkerPool::WorkerPool(int num_threads) {
    try {
        for (int worker = 1; worker < num_threads; ++worker)
            threads_.emplace_back([this, worker] { work(worker); });
    } catch (...) {
        stop();
        throw;
    }
}

WorkerPool::~WorkerPool() {
    stop();
}

void WorkerPool::stop() {
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        stopping_ = true;
    }
    loop_started_.notify_all();
    for (std::thread& thread : threads_) thread.join();
}

void WorkerPool::run_tasks(const Loop& loop, int worker) {
    for (int64_t index = next_index_++; index < loop.count; index = next_index_++)
        loop.call(loop.callable, index, worker);
}

void WorkerPool::run_loop(const Loop& loop) {
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        next_index_ = 0;
        loop_ = &loop;
        ++num_started_;
    }
    loop_started_.notify_all();
    run_tasks(loop, 0);
    std::unique_lock<std::mutex> lock(mutex_);
    loop_ = nullptr;
    lock.unlock();
    spin_until([this] { return num_inside_ == 0; });
    lock.lock();
    workers_left_.wait(lock, [this] { return num_inside_ == 0; });
}

void WorkerPool::work(int worker) {
    const FlushSubnormals flush;
    uint32_t num_seen = 0;
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
        lock.unlock();
        spin_until([&] { return num_started_ != num_seen; });
        lock.lock();
        loop_started_.wait(lock, [&] { return stopping_ || num_started_ != num_seen; });
        if (stopping_) return;
        num_seen = num_started_;
        if (!loop_) continue;
        const Loop loop = *loop_;
        ++num_inside_;
        lock.unlock();
        run_tasks(loop, worker);
        lock.lock();
        if (--num_inside_ == 0) workers_left_.notify_one();
    }
}

}  // namespace clba
