// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

namespace clba {

// Threads that run the tasks of one loop at a time together with the caller. After a loop they look
// for the next one for some microseconds, then sleep. The workers flush subnormal
// numbers; a caller that wants the same results from all tasks does too.
class WorkerPool {
public:
    // num_threads >= 1 counts the caller.
    explicit WorkerPool(int num_threads);
    ~WorkerPool();
    WorkerPool(const WorkerPool&) = delete;
    WorkerPool& operator=(const WorkerPool&) = delete;

    int num_threads() const { return static_cast<int>(threads_.size()) + 1; }

    // task(index, worker) for index in [0, count), each once, started in ascending order, on
    // workers [0, num_threads); the caller is worker 0. The task must not throw.
    template <class Task>
    void run(int64_t count, const Task& task) {
        if (threads_.empty() || count <= 1) {
            for (int64_t index = 0; index < count; ++index) task(index, 0);
            return;
        }
        run_loop({count, &task, [](const void* callable, int64_t index, int worker) {
                      (*static_cast<const Task*>(callable))(index, worker);
                  }});
    }

private:
    struct Loop {
        int64_t count;
        const void* callable;
        void (*call)(const void*, int64_t, int);
    };

    void run_loop(const Loop& loop);
    void run_tasks(const Loop& loop, int worker);
    void work(int worker);
    void stop();

    std::vector<std::thread> threads_;
    std::mutex mutex_;
    std::condition_variable loop_started_, workers_left_;
    const Loop* loop_ = nullptr;  // open to workers; this and the next three change under mutex_
    bool stopping_ = false;
    std::atomic<int> num_inside_{0};        // workers that run tasks of the loop
    std::atomic<uint32_t> num_started_{0};  // loops
    std::atomic<int64_t> next_index_{0};
};

}  // namespace clba
