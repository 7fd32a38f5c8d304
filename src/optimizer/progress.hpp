// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <vector>

#include "optimizer/summary.hpp"

namespace clba {

struct ProgressLimits {
    double function_tolerance = 0;
    int max_iterations = 0;
    double seconds_left = 0;  // of the budget; may be infinite
};

// What is left of a solve: -1 and -1 where that is unknown.
struct Remaining {
    int iterations = -1;
    double seconds = -1;
};

// An estimate from the rows so far, the last one included. The relative changes of the cost in
// accepted steps fall by a factor a step, of which the last few give the geometric mean; so many
// more steps make the next change smaller than the function tolerance. Where they do not fall the
// limit on iterations alone counts. Seconds are those of as many iterations as the last few took on
// average. Both are cut to the budgets. Unknown before two accepted steps.
Remaining estimate_remaining(const std::vector<IterationRow>& rows, const ProgressLimits& limits);

}  // namespace clba
