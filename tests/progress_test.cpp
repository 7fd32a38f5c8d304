// SPDX-License-Identifier: Apache-2.0
// The estimate of what is left of a solve, from rows of known trends.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "optimizer/progress.hpp"

namespace clba {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

// The cost falls by the shares first, first factor, first factor^2, ... an iteration of 2 seconds.
std::vector<IterationRow> falling(int num_iterations, double first, double factor) {
    std::vector<IterationRow> rows(1);
    rows[0].cost = 1000;
    for (int i = 1; i <= num_iterations; ++i) {
        IterationRow row;
        row.iteration = i;
        row.step_is_accepted = row.step_is_valid = true;
        row.cost = rows.back().cost / (1 + first);
        row.cost_change = rows.back().cost - row.cost;
        row.seconds = 2 * i;
        rows.push_back(row);
        first *= factor;
    }
    return rows;
}

TEST(Progress, IsUnknownBeforeTwoSteps) {
    const ProgressLimits limits{1e-6, 50, infinity};
    EXPECT_EQ(estimate_remaining(falling(0, 0.5, 0.1), limits).iterations, -1);
    const Remaining remaining = estimate_remaining(falling(1, 0.5, 0.1), limits);
    EXPECT_EQ(remaining.iterations, -1);
    EXPECT_EQ(remaining.seconds, -1);
}

TEST(Progress, CountsTheStepsOfAGeometricTrend) {
    // Changes of 0.1, 0.01, 0.001; then 1e-4, 1e-5 and 0.9e-6.
    const Remaining remaining =
        estimate_remaining(falling(3, 0.1, 0.1), {1e-5 * 1.01, 50, infinity});
    EXPECT_EQ(remaining.iterations, 2);
    EXPECT_NEAR(remaining.seconds, 4, 1e-9);
    EXPECT_EQ(estimate_remaining(falling(3, 0.1, 0.1), {1e-6 * 1.01, 50, infinity}).iterations, 3);
    EXPECT_EQ(estimate_remaining(falling(6, 0.1, 0.1), {1e-5, 50, infinity}).iterations, 0);
}

TEST(Progress, KeepsToTheBudgets) {
    EXPECT_EQ(estimate_remaining(falling(3, 0.1, 0.9), {1e-9, 10, infinity}).iterations, 7);
    EXPECT_EQ(estimate_remaining(falling(3, 0.1, 0.9), {1e-9, 10, 5}).seconds, 5);
    // Changes that grow, and a tolerance that is never met.
    EXPECT_EQ(estimate_remaining(falling(3, 0.1, 1.5), {1e-6, 10, infinity}).iterations, 7);
    EXPECT_EQ(estimate_remaining(falling(3, 0.1, 0.1), {0, 10, infinity}).iterations, 7);
    EXPECT_EQ(estimate_remaining(falling(3, 0.1, 0.1), {1e-6, 3, infinity}).iterations, 0);
}

TEST(Progress, LeavesRejectedStepsOutOfTheTrend) {
    std::vector<IterationRow> rows = falling(3, 0.1, 0.1);
    IterationRow rejected = rows.back();
    rejected.iteration = 4;
    rejected.step_is_accepted = false;
    rejected.cost_change = -5;
    rejected.seconds = 8;
    rows.push_back(rejected);
    EXPECT_EQ(estimate_remaining(rows, {1e-5 * 1.01, 50, infinity}).iterations, 2);
}

}  // namespace
}  // namespace clba
