// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// Fields as in clba_filter_options.
struct OutlierRules {
    bool in_sigmas = false;
    double max_error = 4;
    double min_angle = 1.5;  // degrees
    int32_t min_views = 2;
    bool remove_behind = true;
};

// Why an observation is an outlier: the first rule that it breaks, in this order.
enum class OutlierReason : uint8_t { none, behind, large_error, few_views, small_angle };
inline constexpr size_t num_outlier_reasons = 5;

struct Outliers {
    std::vector<uint8_t> reasons;  // of each observation, as numbers
    std::array<int64_t, num_outlier_reasons> num_observations{};
    int32_t num_points_few_views = 0, num_points_small_angle = 0;
};

Outliers find_outliers(const Problem& problem, const OutlierRules& rules);

}  // namespace clba
