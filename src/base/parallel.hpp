// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <cstdint>
#include <functional>

namespace clba {

// Threads that work on the host, the caller's included: one a processor, 8 at most, as what they do
// here is bound by memory.
int num_workers();

// function(task, worker) for every task below num_tasks, with 0 <= worker < num_workers() a number
// that no other thread has at the same time. Tasks are handed out one by one in their order. The
// first exception stops the handing out and is thrown again here, once all threads have ended.
// Where the system gives no more threads, those that there are do all the work.
void parallel_for(int64_t num_tasks, const std::function<void(int64_t task, int worker)>& function);

// function(begin, end) for ranges that cover [0, size) and have `grain` items or more, where there
// are so many: a grain should be worth some 50 microseconds, what it takes to start a thread.
template <class Function>
void parallel_ranges(int64_t size, int64_t grain, Function&& function) {
    const int64_t num_ranges =
        std::clamp<int64_t>(size / grain, 1, 4 * static_cast<int64_t>(num_workers()));
    parallel_for(num_ranges, [&](int64_t range, int) {
        function(size * range / num_ranges, size * (range + 1) / num_ranges);
    });
}

}  // namespace clba
