// SPDX-License-Identifier: Apache-2.0
#include "base/parallel.hpp"

#include <atomic>
#include <exception>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

namespace clba {

int num_workers() {
    static const int number =
        std::clamp(static_cast<int>(std::thread::hardware_concurrency()), 1, 8);
    return number;
}

void parallel_for(int64_t num_tasks,
                  const std::function<void(int64_t task, int worker)>& function) {
    std::atomic<int64_t> next{0};
    std::exception_ptr error;
    std::mutex mutex;  // guards error
    const auto work = [&](int worker) noexcept {
        try {
            for (int64_t task = next++; task < num_tasks; task = next++) function(task, worker);
        } catch (...) {
            next = num_tasks;
            const std::lock_guard lock(mutex);
            if (!error) error = std::current_exception();
        }
    };
    const auto num_helpers = static_cast<int>(std::min<int64_t>(num_workers(), num_tasks) - 1);
    std::vector<std::thread> helpers;
    try {
        for (int helper = 0; helper < num_helpers; ++helper) helpers.emplace_back(work, helper + 1);
    } catch (const std::system_error&) {
    } catch (const std::bad_alloc&) {
    }
    work(0);
    for (std::thread& helper : helpers) helper.join();
    if (error) std::rethrow_exception(error);
}

}  // namespace clba
