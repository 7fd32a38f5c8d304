// SPDX-License-Identifier: Apache-2.0
// Reprojection errors and the removal of outliers, through clba.h.
#include <algorithm>
#include <iterator>
#include <limits>
#include <numeric>

#include "api_rig.hpp"

namespace clba_test {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double focal_length = 100;

// Images 0 to 3 look along +z from (i, 0, 0). What is wrong with each point is in its name.
enum Planted {
    fine,
    wrong_once,
    behind,
    far_away,
    lonely,
    lonely_when_cleaned,
    unseen,
    fixed,
    twice
};

struct Sighting {
    int32_t image;
    Planted point;
    double error = 0;  // pixels, in x
};
const Sighting sightings[] = {{0, fine},
                              {1, fine},
                              {2, fine},
                              {0, wrong_once},
                              {1, wrong_once, 10},
                              {2, wrong_once, 3},
                              {0, behind},
                              {3, behind},
                              {0, far_away},
                              {1, far_away},
                              {2, far_away},
                              {0, lonely},
                              {0, lonely_when_cleaned},
                              {1, lonely_when_cleaned, -10},
                              {0, fixed},
                              {1, twice},
                              {1, twice, 1}};
constexpr int64_t num_sightings = std::size(sightings);

Data planted() {
    Data data;
    data.models = {CLBA_CAMERA_SIMPLE_PINHOLE};
    data.params = {focal_length, 0, 0};
    for (int i = 0; i < 4; ++i) {
        data.cameras.push_back(0);
        data.poses.insert(data.poses.end(), {1, 0, 0, 0, -1.0 * i, 0, 0});
    }
    data.xyz = {1, 0, 5,    1, 0.5, 5, 0.5, 0, -5, 0, 0, 1000, 1, 1,
                5, 1, -0.5, 5, 0,   0, 9,   1, 2,  5, 1, 0,    6};
    for (const Sighting& sighting : sightings) {
        const double* x = data.xyz.data() + 3 * sighting.point;
        data.images.push_back(sighting.image);
        data.points.push_back(sighting.point);
        data.xy.push_back(focal_length * (x[0] - sighting.image) / x[2] + sighting.error);
        data.xy.push_back(focal_length * x[1] / x[2]);
    }
    return data;
}

Problem planted_problem() {
    Problem problem = problem_of(planted());
    std::vector<int32_t> constant(9, 0);
    constant[fixed] = 1;
    EXPECT_OK(clba_problem_set_constant_points(problem.get(), 9, constant.data(), 0));
    return problem;
}

std::vector<double> errors_of(const Problem& problem, int32_t unit) {
    std::vector<double> errors(static_cast<size_t>(info_of(problem).num_observations));
    EXPECT_OK(clba_problem_get_reprojection_errors(
        problem.get(), unit, 0, static_cast<int64_t>(errors.size()), errors.data(), 0));
    return errors;
}

// A report with all its arrays.
struct Report {
    explicit Report(const Problem& problem)
        : observations(static_cast<size_t>(info_of(problem).num_observations), -2),
          points(static_cast<size_t>(info_of(problem).num_points), -2),
          images(static_cast<size_t>(info_of(problem).num_images), -2) {
        counts.struct_size = sizeof counts;
        counts.observation_rows = observations.data();
        counts.point_rows = points.data();
        counts.unobserved_images = images.data();
    }
    std::vector<int64_t> observations;
    std::vector<int32_t> points, images;
    clba_filter_report counts{};
};

clba_filter_options filter_options() {
    clba_filter_options options;
    EXPECT_OK(clba_filter_options_init(&options, sizeof options));
    return options;
}

TEST(ReprojectionErrors, InPixelsAndInSigmas) {
    const Problem problem = planted_problem();
    std::vector<double> sigmas(num_sightings);
    std::iota(sigmas.begin(), sigmas.end(), 1.0);
    EXPECT_OK(clba_problem_set_sigmas(problem.get(), num_sightings, sigmas.data(), 0));
    const std::vector<double> pixels = errors_of(problem, CLBA_UNIT_PIXELS);
    const std::vector<double> whitened = errors_of(problem, CLBA_UNIT_SIGMAS);
    for (size_t i = 0; i < num_sightings; ++i) {
        EXPECT_NEAR(pixels[i], std::abs(sightings[i].error), 1e-12) << i;
        EXPECT_NEAR(whitened[i], std::abs(sightings[i].error) / sigmas[i], 1e-12) << i;
    }
    double two[4] = {-1, -1, -1, -1};  // every other number
    EXPECT_OK(clba_problem_get_reprojection_errors(problem.get(), CLBA_UNIT_PIXELS, 4, 2, two,
                                                   2 * sizeof(double)));
    EXPECT_NEAR(two[0], 10, 1e-12);
    EXPECT_EQ(two[1], -1);
    EXPECT_NEAR(two[2], 3, 1e-12);
    EXPECT_TRUE(refused(clba_problem_get_reprojection_errors(problem.get(), 3, 0, 1, two, 0),
                        {"unit = 3", "1 and 2"}));
    EXPECT_TRUE(refused(clba_problem_get_reprojection_errors(problem.get(), CLBA_UNIT_PIXELS,
                                                             num_sightings, 1, two, 0),
                        {"17", "observations"}));
}

TEST(Filter, CountsEachReasonAndKeepsTheRest) {
    const Problem problem = planted_problem();
    std::vector<double> sigmas(num_sightings);
    for (size_t i = 0; i < num_sightings; ++i) sigmas[i] = 1 + 0.1 * static_cast<double>(i);
    EXPECT_OK(clba_problem_set_sigmas(problem.get(), num_sightings, sigmas.data(), 0));
    Report report(problem);
    ASSERT_OK(clba_problem_filter(problem.get(), nullptr, &report.counts));
    EXPECT_EQ(report.counts.num_behind, 2);
    EXPECT_EQ(report.counts.num_large_error, 2);
    EXPECT_EQ(report.counts.num_few_views, 4);  // lonely, lonely_when_cleaned, twice
    EXPECT_EQ(report.counts.num_points_few_views, 3);
    EXPECT_EQ(report.counts.num_small_angle, 3);
    EXPECT_EQ(report.counts.num_points_small_angle, 1);
    EXPECT_EQ(report.counts.num_observations_removed, 11);
    EXPECT_EQ(report.counts.num_points_unobserved, 5);
    EXPECT_EQ(report.counts.num_points_removed, 0);
    EXPECT_EQ(report.counts.num_images_unobserved, 1);
    EXPECT_EQ(report.images, (std::vector<int32_t>{0, 0, 0, 1}));
    EXPECT_EQ(report.points, (std::vector<int32_t>{0, 1, 2, 3, 4, 5, 6, 7, 8}));
    EXPECT_EQ(report.observations,
              (std::vector<int64_t>{0, 1, 2, 3, -1, 4, -1, -1, -1, -1, -1, -1, -1, -1, 5, -1, -1}));
    // Measurements and covariances went with their rows.
    EXPECT_EQ(info_of(problem).num_observations, 6);
    EXPECT_EQ(data_of(problem).points,
              (std::vector<int32_t>{fine, fine, fine, wrong_once, wrong_once, fixed}));
    EXPECT_NEAR(errors_of(problem, CLBA_UNIT_PIXELS)[4], 3, 1e-12);
    EXPECT_NEAR(errors_of(problem, CLBA_UNIT_SIGMAS)[4], 3 / sigmas[5], 1e-12);

    Report again(problem);
    ASSERT_OK(clba_problem_filter(problem.get(), nullptr, &again.counts));
    EXPECT_EQ(again.counts.num_observations_removed, 0);
    EXPECT_EQ(again.counts.num_images_unobserved, 0);
}

TEST(Filter, RemovesPointsIfAskedTo) {
    const Problem problem = planted_problem();
    clba_filter_options options = filter_options();
    options.remove_points = 1;
    Report report(problem);
    ASSERT_OK(clba_problem_filter(problem.get(), &options, &report.counts));
    EXPECT_EQ(report.counts.num_points_removed, 6);  // with the one that had no observation
    EXPECT_EQ(report.counts.num_points_unobserved, 5);
    EXPECT_EQ(report.points, (std::vector<int32_t>{0, 1, -1, -1, -1, -1, -1, 2, -1}));
    const Data before = planted(), after = data_of(problem);
    ASSERT_EQ(after.num_points(), 3);
    for (size_t p : {size_t{fine}, size_t{wrong_once}, size_t{fixed}}) {
        const auto row = static_cast<size_t>(report.points[p]);
        for (size_t k = 0; k < 3; ++k) EXPECT_EQ(after.xyz[3 * row + k], before.xyz[3 * p + k]);
    }
    EXPECT_EQ(after.points, (std::vector<int32_t>{0, 0, 0, 1, 1, 2}));
    // The constant point is the last one now, which the rules on points leave alone.
    options.min_num_views = 4;
    ASSERT_OK(clba_problem_filter(problem.get(), &options, nullptr));
    const Data last = data_of(problem);
    EXPECT_EQ(last.xyz, (std::vector<double>{before.xyz[21], before.xyz[22], before.xyz[23]}));
}

TEST(Filter, RulesCanBeLeftOut) {
    const auto removed = [](auto&& change) {
        const Problem problem = planted_problem();
        clba_filter_options options = filter_options();
        options.max_reprojection_error = infinity;
        options.min_triangulation_angle = 0;
        options.min_num_views = 0;
        options.remove_behind = 0;
        change(options);
        Report report(problem);
        EXPECT_OK(clba_problem_filter(problem.get(), &options, &report.counts));
        return report.counts.num_observations_removed;
    };
    EXPECT_EQ(removed([](clba_filter_options&) {}), 0);
    EXPECT_EQ(removed([](clba_filter_options& o) { o.remove_behind = 1; }), 2);
    EXPECT_EQ(removed([](clba_filter_options& o) { o.max_reprojection_error = 4; }), 2);
    EXPECT_EQ(removed([](clba_filter_options& o) { o.max_reprojection_error = 2.9; }), 3);
    EXPECT_EQ(removed([](clba_filter_options& o) { o.min_num_views = 2; }), 3);
    // The rays of far_away enclose 2 atan(1 / 1000), and points of one view nothing.
    const double angle = 2 * std::atan(1e-3) * 180 / 3.14159265358979323846;
    EXPECT_EQ(removed([&](clba_filter_options& o) { o.min_triangulation_angle = angle * 0.9999; }),
              3);
    EXPECT_EQ(removed([&](clba_filter_options& o) { o.min_triangulation_angle = angle * 1.0001; }),
              6);
}

TEST(Filter, MeasuresInSigmas) {
    const Problem problem = planted_problem();
    const std::vector<double> sigmas(num_sightings, 5);
    EXPECT_OK(clba_problem_set_sigmas(problem.get(), num_sightings, sigmas.data(), 0));
    clba_filter_options options = filter_options();
    options.error_unit = CLBA_UNIT_SIGMAS;
    options.max_reprojection_error = 2.1;
    Report report(problem);
    ASSERT_OK(clba_problem_filter(problem.get(), &options, &report.counts));
    EXPECT_EQ(report.counts.num_large_error, 0);
}

TEST(Filter, RefusesOptionsOutOfRange) {
    const Problem problem = planted_problem();
    const Data before = data_of(problem);
    const auto with = [&](auto&& change) {
        clba_filter_options options = filter_options();
        change(options);
        return clba_problem_filter(problem.get(), &options, nullptr);
    };
    EXPECT_TRUE(refused(with([](auto& o) { o.error_unit = 0; }), {"error_unit = 0"}));
    EXPECT_TRUE(refused(with([](auto& o) { o.max_reprojection_error = 0; }),
                        {"max_reprojection_error = 0", "> 0"}));
    EXPECT_TRUE(refused(with([](auto& o) { o.min_triangulation_angle = 180; }),
                        {"min_triangulation_angle = 180"}));
    EXPECT_TRUE(refused(with([](auto& o) { o.min_num_views = -1; }), {"min_num_views = -1"}));
    EXPECT_TRUE(refused(with([](auto& o) { o.reserved = 1; }), {"reserved = 1"}));
    clba_filter_report report{};
    EXPECT_TRUE(refused(clba_problem_filter(problem.get(), nullptr, &report), {"struct_size = 0"}));
    EXPECT_TRUE(refused(clba_problem_filter(nullptr, nullptr, nullptr), {"problem", "NULL"}));
    EXPECT_TRUE(data_of(problem) == before);
}

TEST(RemoveObservations, TakesTheCallersFlags) {
    const Problem problem = planted_problem();
    std::vector<int32_t> flags(num_sightings, 0);
    flags[0] = flags[11] = 1;
    Report report(problem);
    ASSERT_OK(clba_problem_remove_observations(problem.get(), num_sightings, flags.data(), 0, 1,
                                               &report.counts));
    EXPECT_EQ(report.counts.num_observations_removed, 2);
    EXPECT_EQ(report.counts.num_points_unobserved, 1);  // lonely
    EXPECT_EQ(report.counts.num_points_removed, 2);     // and unseen
    EXPECT_EQ(report.observations[1], 0);
    EXPECT_EQ(info_of(problem).num_observations, num_sightings - 2);
    EXPECT_TRUE(
        refused(clba_problem_remove_observations(problem.get(), 3, flags.data(), 0, 0, nullptr),
                {"count = 3", "15 observations"}));
}

TEST(Filter, OutliersOfAGeneratedSceneGo) {
    const Scene scene = generate(0.1, 8, 60);
    const Context context = make_context();
    const Data before = data_of(scene.truth);
    const std::vector<double> errors = errors_of(scene.truth, CLBA_UNIT_PIXELS);
    const auto num_large =
        std::count_if(errors.begin(), errors.end(), [](double e) { return e > 4; });
    ASSERT_GT(num_large, 20);
    Report report(scene.truth);
    ASSERT_OK(clba_problem_filter(scene.truth.get(), nullptr, &report.counts));
    EXPECT_EQ(report.counts.num_large_error + report.counts.num_behind, num_large);
    // The problem can be solved before and after on the same context.
    const double cost = cost_of(scene.truth, context);
    EXPECT_LT(cost, 0.5 * static_cast<double>(2 * info_of(scene.truth).num_observations));
    EXPECT_LE(solve(scene.truth, context, solver_options()).final_cost, cost);
}

}  // namespace
}  // namespace clba_test
