// SPDX-License-Identifier: Apache-2.0
#include "cli/iteration_log.hpp"

#include <unistd.h>

#include <chrono>
#include <cstdio>

namespace cli {

using Clock = std::chrono::steady_clock;

IterationLog::IterationLog(int32_t max_num_iterations) : max_num_iterations_(max_num_iterations) {
    std::printf("%4s  %12s  %11s %10s  %9s  %9s %9s  %7s  %9s  %10s\n", "iter", "cost",
                "cost_change", "|gradient|", "|step|", "tr_ratio", "tr_radius", "ls_iter",
                "iter_time", "total_time");
    std::fflush(stdout);
    if (::isatty(STDERR_FILENO)) progress_ = std::thread([this] { show_progress(); });
}

IterationLog::~IterationLog() {
    if (!progress_.joinable()) return;
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        stop_ = true;
    }
    stopped_.notify_one();
    progress_.join();
    clear_progress();
}

void IterationLog::print(const clba_iteration& row) {
    const std::lock_guard<std::mutex> lock(mutex_);
    clear_progress();
    std::printf("%4d  %12.6e  %11.2e %10.2e  %9.2e  %9.2e %9.2e  %7d  %9.2e  %10.2e\n",
                row.iteration, row.cost, row.cost_change, row.gradient_max_norm, row.step_norm,
                row.gain_ratio, row.trust_region_radius, row.linear_solver_iterations,
                row.seconds - last_row_seconds_, row.seconds);
    std::fflush(stdout);
    last_row_seconds_ = row.seconds;
    remaining_seconds_ = row.remaining_seconds;
    ++num_rows_;
}

void IterationLog::show_progress() {
    constexpr std::chrono::seconds patience(2), period(1);
    std::unique_lock<std::mutex> lock(mutex_);
    const Clock::time_point start = Clock::now();
    Clock::time_point row_start = start;
    int32_t row = 0;
    while (!stopped_.wait_for(lock, period, [this] { return stop_; })) {
        const Clock::time_point now = Clock::now();
        if (row != num_rows_) {
            row = num_rows_;
            row_start = now;
        }
        if (now - row_start < patience) continue;
        const auto seconds = [now](Clock::time_point since) {
            return static_cast<long>(
                std::chrono::duration_cast<std::chrono::seconds>(now - since).count());
        };
        std::fprintf(stderr, "\riteration %d of at most %d: %ld s; in all %ld s", num_rows_,
                     max_num_iterations_, seconds(row_start), seconds(start));
        if (remaining_seconds_ >= 0)
            std::fprintf(stderr, "; some %.0f s to go", remaining_seconds_);
        std::fputs("\033[K", stderr);
        std::fflush(stderr);
        progress_is_shown_ = true;
    }
}

void IterationLog::clear_progress() {
    if (progress_is_shown_) std::fputs("\r\033[K", stderr);
    progress_is_shown_ = false;
}

}  // namespace cli
