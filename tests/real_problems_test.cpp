// SPDX-License-Identifier: Apache-2.0
// Real problems of the folder CLBA_TEST_DATA against the costs that Ceres reaches from the same
// start (sparse_schur, fp64, up to 200 iterations). Skipped, and said so, where the folder is not
// there.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "device_rig.hpp"
#include "io/bal.hpp"
#include "optimizer/solve.hpp"
#include "reference/bundle.hpp"

namespace clba {
namespace {

std::string data_file(const std::string& name) {
    const char* folder = std::getenv("CLBA_TEST_DATA");
    return (std::filesystem::path(folder ? folder : "") / (name + ".txt.bz2")).string();
}

#define REQUIRE_DATA(name)                         \
    if (!std::filesystem::exists(data_file(name))) \
    GTEST_SKIP() << "no file " << data_file(name) << "; set CLBA_TEST_DATA"

Summary run(Problem& problem, const MinimizerOptions& options, Precision precision) {
    std::unique_ptr<DeviceProblem> device;
    return solve(problem, test::test_context(), options, precision, device);
}

struct RealProblem {
    const char* name;
    double ceres;        // cost
    bool has_converged;  // Ceres had; if not, a lower cost is right
};
void PrintTo(const RealProblem& problem, std::ostream* stream) {
    *stream << problem.name;
}

class RealProblems : public testing::TestWithParam<RealProblem> {};

TEST_P(RealProblems, EndAtTheCostOfCeresOrBelow) {
    REQUIRE_DATA(GetParam().name);
    Problem problem = read_bal(data_file(GetParam().name));
    MinimizerOptions options;
    options.max_iterations = 100;
    const Summary summary = run(problem, options, Precision::mixed);
    EXPECT_LE(summary.reference_final_cost,
              GetParam().ceres * (GetParam().has_converged ? 1 + 1e-3 : 1 + 1e-2))
        << summary.message;
    EXPECT_NEAR(summary.final_cost, summary.reference_final_cost,
                1e-10 * summary.reference_final_cost);
}

INSTANTIATE_TEST_SUITE_P(
    DataIndex, RealProblems,
    testing::Values(RealProblem{"bal/problem-16-22106-pre", 18033.9035, true},
                    RealProblem{"bal/problem-21-11315-pre", 30378.6358, true},
                    RealProblem{"bal/problem-49-7776-pre", 13344.2439, false},
                    RealProblem{"real/olsson-Cherub", 108496.01, true},
                    RealProblem{"real/olsson-Cherub-perturbed", 108496.01, true},
                    RealProblem{"real/olsson-De_Guerre-perturbed", 9163.83088, true},
                    RealProblem{"real/dbat-roma-60", 15156.7221, true},
                    RealProblem{"real/colmap-gtsfm_set1_lund_door", 10852.6522, true},
                    RealProblem{"real/colmap-softmurata", 233155.914, false},
                    RealProblem{"real/libmv-problem_02", 4798.93253, true},
                    RealProblem{"real/kitti-2011_09_30_drive_0027-stereo-deadreckoned", 113146.592,
                                false},
                    RealProblem{"real/malaga-170-gtpose-clean", 2874.24871, false},
                    RealProblem{"real/strecha-Herz-Jesus-P25", 28309.891, true},
                    RealProblem{"real/strecha-fountain-P11", 8278.65767, true}));

class DataIndex : public testing::TestWithParam<const char*> {};

// To 1e-4 or lower, from the same start in as many iterations.
TEST_P(DataIndex, SinglePrecisionEndsAtTheCostOfDouble) {
    REQUIRE_DATA(GetParam());
    const Problem start = read_bal(data_file(GetParam()));
    MinimizerOptions options;
    options.linear_solver.kind = LinearSolverKind::automatic;
    Problem problem = start;
    const double expected = run(problem, options, Precision::double_precision).reference_final_cost;
    problem = start;
    const Summary summary = run(problem, options, Precision::single);
    EXPECT_LE(summary.reference_final_cost, expected * (1 + 1e-4)) << summary.message;
    EXPECT_NEAR(summary.final_cost, summary.reference_final_cost,
                4e-5 * summary.reference_final_cost);
}

// fakepile has gross outliers, without a robust loss many minima.
INSTANTIATE_TEST_SUITE_P(
    Bal, DataIndex,
    testing::Values("bal/problem-16-22106-pre", "bal/problem-21-11315-pre",
                    "bal/problem-49-7776-pre", "real/colmap-gtsfm_set1_lund_door",
                    "real/colmap-softmurata", "real/dbat-roma-60", "real/fakepile-47",
                    "real/kitti-2011_09_30_drive_0027-stereo-deadreckoned", "real/libmv-problem_02",
                    "real/malaga-170-gtpose-clean", "real/olsson-Cherub",
                    "real/olsson-Cherub-perturbed", "real/olsson-De_Guerre-perturbed",
                    "real/strecha-Herz-Jesus-P25", "real/strecha-fountain-P11"));

struct Method {
    LinearSolverKind kind;
    Preconditioner preconditioner;
    double eta;
};
constexpr Method methods[] = {
    {LinearSolverKind::pcg_schur, Preconditioner::schur_jacobi, 0.1},
    {LinearSolverKind::pcg_schur, Preconditioner::block_jacobi, 1e-2},
    {LinearSolverKind::pcg_hessian, Preconditioner::block_jacobi, 1e-3},
    {LinearSolverKind::direct_schur, Preconditioner::none, 0.1},
};

TEST(Dubrovnik16, SevenDigitsByEverySolver) {
    REQUIRE_DATA("bal/problem-16-22106-pre");
    const Problem start = read_bal(data_file("bal/problem-16-22106-pre"));
    for (const Method& method : methods) {
        for (const Precision precision : {Precision::double_precision, Precision::mixed}) {
            MinimizerOptions options;
            options.linear_solver.kind = method.kind;
            options.linear_solver.preconditioner = method.preconditioner;
            options.linear_solver.eta = method.eta;
            Problem problem = start;
            const Summary summary = run(problem, options, precision);
            EXPECT_NEAR(summary.initial_cost, 4185659.51825, 1e-5);
            EXPECT_NEAR(summary.reference_final_cost, 18033.9034788, 0.5e-7 * 18033.9034788)
                << "solver " << static_cast<int>(method.kind) << ", " << real_type(precision);
        }
    }
}

TEST(Ladybug49, PointsBehindTheirCamerasAreKept) {
    REQUIRE_DATA("bal/problem-49-7776-pre");
    Problem problem = read_bal(data_file("bal/problem-49-7776-pre"));
    MinimizerOptions options;
    options.max_iterations = 100;
    const Summary summary = run(problem, options, Precision::mixed);
    EXPECT_EQ(summary.num_behind_initial, 31);
    EXPECT_LE(summary.reference_final_cost, 13344.5);
}

// Gross outliers: with a robust loss half of the residuals are at most 0.07 pixels.
TEST(Fakepile, RobustLossFindsTheInliers) {
    REQUIRE_DATA("real/fakepile-47");
    Problem problem = read_bal(data_file("real/fakepile-47"));
    problem.loss = {LossKind::soft_l1, 1.0};
    MinimizerOptions options;
    options.max_iterations = 200;
    run(problem, options, Precision::mixed);
    problem.loss = {};
    std::vector<double> residuals(2 * problem.observations.size());
    reference::residual(problem, residuals.data());
    std::vector<double> norms;
    for (size_t i = 0; i < residuals.size(); i += 2)
        norms.push_back(std::hypot(residuals[i], residuals[i + 1]));
    std::nth_element(norms.begin(), norms.begin() + static_cast<long>(norms.size() / 2),
                     norms.end());
    EXPECT_LE(norms[norms.size() / 2], 0.07);
}

}  // namespace
}  // namespace clba
