// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <atomic>
#include <cmath>

#include "base/stopwatch.hpp"

namespace clba {

enum class StopCause { none, cancelled, out_of_time };

// Whether long work is to end: asked between its parts, from any of its threads.
class StopTest {
public:
    StopTest() = default;  // never
    // cancelled may be NULL; the time begins now.
    StopTest(const std::atomic<bool>* cancelled, double seconds)
        : cancelled_(cancelled), seconds_(seconds) {}

    StopCause cause() const {
        if (cancelled_ && *cancelled_) return StopCause::cancelled;
        if (std::isfinite(seconds_) && watch_.seconds() >= seconds_) return StopCause::out_of_time;
        return StopCause::none;
    }

private:
    const std::atomic<bool>* cancelled_ = nullptr;
    double seconds_ = INFINITY;
    Stopwatch watch_;
};

}  // namespace clba
