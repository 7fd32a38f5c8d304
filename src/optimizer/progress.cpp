// SPDX-License-Identifier: Apache-2.0
#include "optimizer/progress.hpp"

#include <algorithm>
#include <cmath>

namespace clba {
namespace {

constexpr size_t num_recent = 4;  // steps that make the trend

}  // namespace

Remaining estimate_remaining(const std::vector<IterationRow>& rows, const ProgressLimits& limits) {
    std::vector<double> changes;  // relative, the latest first
    for (auto row = rows.rbegin(); row != rows.rend() && changes.size() < num_recent; ++row)
        if (row->iteration > 0 && row->step_is_accepted && row->cost > 0)
            changes.push_back(row->cost_change / row->cost);
    if (changes.size() < 2) return {};

    const int most = std::max(limits.max_iterations - rows.back().iteration, 0);
    const double factor =
        std::pow(changes.front() / changes.back(), 1 / static_cast<double>(changes.size() - 1));
    double iterations = most;
    if (factor < 1 && limits.function_tolerance > 0)
        iterations =
            std::ceil(std::log(limits.function_tolerance / changes.front()) / std::log(factor));
    Remaining remaining;
    remaining.iterations = static_cast<int>(std::clamp<double>(iterations, 0, most));

    const size_t window = std::min(rows.size() - 1, num_recent);
    const double seconds_per_iteration =
        (rows.back().seconds - rows[rows.size() - 1 - window].seconds) /
        static_cast<double>(window);
    remaining.seconds = std::clamp<double>(remaining.iterations * seconds_per_iteration, 0,
                                           std::max(limits.seconds_left, 0.0));
    return remaining;
}

}  // namespace clba
