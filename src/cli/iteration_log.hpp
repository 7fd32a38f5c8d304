// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <condition_variable>
#include <mutex>
#include <thread>

#include "clba/clba.h"

namespace cli {

// Prints the rows of a solve to standard output in the columns of Ceres. While an iteration takes
// long and standard error is a terminal, a line there says which one runs and for how long.
class IterationLog {
public:
    explicit IterationLog(int32_t max_num_iterations);
    ~IterationLog();
    IterationLog(const IterationLog&) = delete;
    IterationLog& operator=(const IterationLog&) = delete;

    void print(const clba_iteration& row);

private:
    void show_progress();
    void clear_progress();

    const int32_t max_num_iterations_;
    std::mutex mutex_;
    std::condition_variable stopped_;
    bool stop_ = false;  // this and the rest are guarded by mutex_
    int32_t num_rows_ = 0;
    double last_row_seconds_ = 0;  // of the solve's own clock
    double remaining_seconds_ = -1;
    bool progress_is_shown_ = false;
    std::thread progress_;  // runs on a terminal only
};

}  // namespace cli
