// SPDX-License-Identifier: Apache-2.0
#include "reference/scene.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <set>

#include "base/error.hpp"
#include "reference/compare.hpp"

namespace clba {
namespace {

constexpr SceneKind all_kinds[] = {SceneKind::hall, SceneKind::street, SceneKind::landmark};

SceneOptions options_of(SceneKind kind, int32_t num_images, int32_t observations_per_image) {
    SceneOptions options;
    options.kind = kind;
    options.num_images = num_images;
    options.observations_per_image = observations_per_image;
    return options;
}

// The snavely camera of clba.h: u = -P.x / P.z, v = -P.y / P.z, f (1 + k1 r2 + k2 r2^2) u, ...
struct Projection {
    double x, y, depth;
};
Projection project(const Problem& problem, const Observation& o) {
    const Image& image = problem.images[o.image];
    const Point& point = problem.points[o.point];
    const auto r = rotation_matrix(image.pose.rotation);
    double p[3];
    for (int k = 0; k < 3; ++k)
        p[k] = r[3 * k] * point[0] + r[3 * k + 1] * point[1] + r[3 * k + 2] * point[2] +
               image.pose.translation[k];
    const double u = -p[0] / p[2], v = -p[1] / p[2], r2 = u * u + v * v;
    const auto& params = problem.cameras[image.camera].params;
    const double scale = params[0] * (1 + params[1] * r2 + params[2] * r2 * r2);
    return {scale * u, scale * v, -p[2]};
}

double rms_error(const Problem& problem) {
    double sum = 0;
    for (const Observation& o : problem.observations) {
        const Projection projection = project(problem, o);
        sum += std::pow(projection.x - o.x, 2) + std::pow(projection.y - o.y, 2);
    }
    return std::sqrt(sum / (2.0 * static_cast<double>(problem.observations.size())));
}

std::vector<int> counts_by_image(const Problem& problem) {
    std::vector<int> counts(problem.images.size());
    for (const Observation& o : problem.observations) ++counts[o.image];
    return counts;
}

std::vector<int> counts_by_point(const Problem& problem) {
    std::vector<int> counts(problem.points.size());
    for (const Observation& o : problem.observations) ++counts[o.point];
    return counts;
}

bool same_observations(const Problem& a, const Problem& b) {
    if (a.observations.size() != b.observations.size()) return false;
    for (size_t i = 0; i < a.observations.size(); ++i) {
        const Observation &o = a.observations[i], &q = b.observations[i];
        if (o.image != q.image || o.point != q.point || o.x != q.x || o.y != q.y) return false;
    }
    return true;
}

bool same_state(const Problem& a, const Problem& b) {
    if (a.points != b.points || a.images.size() != b.images.size()) return false;
    for (size_t i = 0; i < a.images.size(); ++i)
        if (a.images[i].pose.rotation != b.images[i].pose.rotation ||
            a.images[i].pose.translation != b.images[i].pose.translation ||
            a.cameras[i].params != b.cameras[i].params)
            return false;
    return true;
}

class SceneTest : public testing::TestWithParam<SceneKind> {};
INSTANTIATE_TEST_SUITE_P(All, SceneTest, testing::ValuesIn(all_kinds));

TEST_P(SceneTest, HasTheSizeAskedFor) {
    for (int32_t num_images : {30, 200}) {
        const Scene scene = generate_scene(options_of(GetParam(), num_images, 300));
        const Problem& truth = scene.truth;
        truth.validate();
        scene.start.validate();
        EXPECT_EQ(truth.num_images(), num_images);
        EXPECT_EQ(truth.num_cameras(), num_images);
        const double per_image = 1.0 * truth.num_observations() / num_images;
        EXPECT_GT(per_image, 0.9 * 300);
        EXPECT_LT(per_image, 1.1 * 300);
        const double track = 1.0 * truth.num_observations() / truth.num_points();
        EXPECT_GT(track, 4);
        EXPECT_LT(track, 6);
        for (int count : counts_by_point(truth)) ASSERT_GE(count, 2);
        for (int count : counts_by_image(truth)) ASSERT_GE(count, 8);
        for (int32_t i = 0; i < num_images; ++i) {
            ASSERT_EQ(truth.images[i].camera, i);
            ASSERT_EQ(truth.cameras[i].model, camera_snavely);
            ASSERT_GT(truth.cameras[i].params[0], 650);
            ASSERT_LT(truth.cameras[i].params[0], 950);
        }
    }
}

TEST_P(SceneTest, ObservationsAreSortedAndOccurOnce) {
    const Problem truth = generate_scene(options_of(GetParam(), 60, 50)).truth;
    for (size_t i = 1; i < truth.observations.size(); ++i) {
        const Observation &before = truth.observations[i - 1], &o = truth.observations[i];
        ASSERT_LT(std::make_pair(before.point, before.image), std::make_pair(o.point, o.image));
    }
}

TEST_P(SceneTest, TruthProjectsToItsObservations) {
    SceneOptions options = options_of(GetParam(), 50, 100);
    options.pixel_noise = 0;
    const Problem truth = generate_scene(options).truth;
    constexpr double tolerance = 1e4 * std::numeric_limits<double>::epsilon() * 1000;
    for (const Observation& o : truth.observations) {
        const Projection projection = project(truth, o);
        ASSERT_GT(projection.depth, 0.99);
        ASSERT_NEAR(projection.x, o.x, tolerance);
        ASSERT_NEAR(projection.y, o.y, tolerance);
        ASSERT_LT(std::abs(o.x), 500);
        ASSERT_LT(std::abs(o.y), 375);
    }
}

TEST_P(SceneTest, TruthHasTheErrorOfThePixelNoise) {
    SceneOptions options = options_of(GetParam(), 100, 200);
    options.pixel_noise = 0.8;
    const Scene scene = generate_scene(options);
    // The relative standard deviation of a root mean square of n normal numbers is 1 / sqrt(2 n).
    const double deviation =
        0.8 / std::sqrt(4.0 * static_cast<double>(scene.truth.num_observations()));
    EXPECT_NEAR(rms_error(scene.truth), 0.8, 5 * deviation);
    EXPECT_GT(rms_error(scene.start), 3);
    EXPECT_LT(rms_error(scene.start), 40);
    EXPECT_TRUE(same_observations(scene.start, scene.truth));
}

TEST_P(SceneTest, StartIsDisturbedAsAskedFor) {
    SceneOptions options = options_of(GetParam(), 300, 50);
    options.rotation_noise = 2;
    options.position_noise = 0;
    options.point_noise = 0.02;
    const Scene scene = generate_scene(options);
    double angle2 = 0, center_distance = 0, distance2 = 0, depth = 0;
    for (int32_t i = 0; i < 300; ++i) {
        const Pose &pose = scene.truth.images[i].pose, &start = scene.start.images[i].pose;
        const auto& q = pose.rotation;
        for (double w : rotation_vector_from_quaternion(
                 quaternion_product(start.rotation, {q[0], -q[1], -q[2], -q[3]})))
            angle2 += w * w / 300;
        for (int k = 0; k < 3; ++k)
            center_distance = std::max(center_distance,
                                       std::abs(camera_center(pose)[k] - camera_center(start)[k]));
        EXPECT_NEAR(scene.start.cameras[i].params[0] / scene.truth.cameras[i].params[0], 1, 0.06);
        EXPECT_EQ(scene.start.cameras[i].params[1], 0);
        EXPECT_EQ(scene.start.cameras[i].params[2], 0);
    }
    for (int32_t p = 0; p < scene.truth.num_points(); ++p)
        for (int k = 0; k < 3; ++k)
            distance2 += std::pow(scene.start.points[p][k] - scene.truth.points[p][k], 2);
    for (const Observation& o : scene.truth.observations) depth += project(scene.truth, o).depth;
    depth /= static_cast<double>(scene.truth.num_observations());
    // Five standard deviations of a root mean square of 900 and of over 5000 normal numbers.
    EXPECT_NEAR(std::sqrt(angle2) * 180 / 3.14159265358979, 2, 2 * 5 / std::sqrt(1800.0));
    EXPECT_NEAR(std::sqrt(distance2 / scene.truth.num_points()), 0.02 * depth,
                0.02 * depth * 5 / std::sqrt(10000.0));
    EXPECT_LT(center_distance, 1e4 * std::numeric_limits<double>::epsilon() * 100);
}

TEST_P(SceneTest, PositionNoiseMovesCenters) {
    SceneOptions options = options_of(GetParam(), 100, 50);
    const Scene scene = generate_scene(options);
    const Comparison comparison = compare(scene.truth, scene.start);
    EXPECT_GT(comparison.median_center_distance, 0.01);
    EXPECT_LT(comparison.max_center_distance, 3);
}

TEST_P(SceneTest, OutliersAreMovedAnywhere) {
    SceneOptions options = options_of(GetParam(), 100, 100);
    options.outlier_share = 0.1;
    const Problem truth = generate_scene(options).truth;
    int64_t num_outliers = 0;
    for (const Observation& o : truth.observations) {
        const Projection projection = project(truth, o);
        num_outliers += std::hypot(projection.x - o.x, projection.y - o.y) > 6;
    }
    const auto n = static_cast<double>(truth.num_observations());
    EXPECT_NEAR(static_cast<double>(num_outliers), 0.1 * n, 5 * std::sqrt(0.1 * 0.9 * n));
    options.outlier_share = 0;
    EXPECT_TRUE(same_state(truth, generate_scene(options).truth));
}

TEST_P(SceneTest, EqualSeedsGiveEqualScenes) {
    SceneOptions options = options_of(GetParam(), 40, 40);
    options.seed = 7;
    options.outlier_share = 0.05;
    const Scene a = generate_scene(options), b = generate_scene(options);
    EXPECT_TRUE(same_state(a.truth, b.truth));
    EXPECT_TRUE(same_state(a.start, b.start));
    EXPECT_TRUE(same_observations(a.start, b.start));
    options.seed = 8;
    const Scene other = generate_scene(options);
    EXPECT_FALSE(same_state(a.truth, other.truth));
    EXPECT_FALSE(same_observations(a.truth, other.truth));
}

TEST_P(SceneTest, FewImagesStillMakeAScene) {
    for (int32_t num_images : {2, 3, 5}) {
        const Problem truth = generate_scene(options_of(GetParam(), num_images, 40)).truth;
        EXPECT_EQ(truth.num_images(), num_images);
        for (int count : counts_by_image(truth)) EXPECT_GE(count, 8);
    }
}

TEST_P(SceneTest, ImagesWithFewObservationsAreFilledUp) {
    const Problem truth = generate_scene(options_of(GetParam(), 100, 12)).truth;
    for (int count : counts_by_image(truth)) EXPECT_GE(count, 8);
    for (size_t i = 1; i < truth.observations.size(); ++i) {
        const Observation &before = truth.observations[i - 1], &o = truth.observations[i];
        ASSERT_LT(std::make_pair(before.point, before.image), std::make_pair(o.point, o.image));
    }
}

TEST_P(SceneTest, NumberOfPointsCanBeGiven) {
    SceneOptions options = options_of(GetParam(), 50, 100);
    options.num_points = 500;
    const Problem truth = generate_scene(options).truth;
    EXPECT_EQ(truth.num_points(), 500);
    EXPECT_GT(truth.num_observations(), 500 * 6);
    EXPECT_LT(truth.num_observations(), 500 * 11);
}

std::vector<std::set<int32_t>> neighbours(const Problem& problem) {
    std::vector<std::vector<int32_t>> tracks(problem.points.size());
    for (const Observation& o : problem.observations) tracks[o.point].push_back(o.image);
    std::vector<std::set<int32_t>> found(problem.images.size());
    for (const auto& track : tracks)
        for (int32_t a : track)
            for (int32_t b : track)
                if (a != b) found[a].insert(b);
    return found;
}

double mean_number(const std::vector<std::set<int32_t>>& found) {
    double sum = 0;
    for (const auto& images : found) sum += static_cast<double>(images.size());
    return sum / static_cast<double>(found.size());
}

TEST(SceneShapeTest, HallOverlapsNeighboursAllRound) {
    const auto found = neighbours(generate_scene(options_of(SceneKind::hall, 356, 400)).truth);
    EXPECT_GT(mean_number(found), 20);
    EXPECT_LT(mean_number(found), 48);
    EXPECT_TRUE(found[0].count(355)) << "the path is closed";
    EXPECT_FALSE(found[0].count(178));
}

TEST(SceneShapeTest, StreetIsANarrowBand) {
    const auto found = neighbours(generate_scene(options_of(SceneKind::street, 300, 100)).truth);
    for (int32_t i = 0; i < 300; ++i)
        for (int32_t j : found[i]) ASSERT_LE(std::abs(i - j), 40);
}

TEST(SceneShapeTest, LandmarkOverlapsFarAndWide) {
    const auto found = neighbours(generate_scene(options_of(SceneKind::landmark, 150, 400)).truth);
    EXPECT_GT(mean_number(found), 60);
}

TEST(SceneOptionsTest, BrokenRulesAreNamed) {
    const auto message = [](auto change) -> std::string {
        SceneOptions options;
        change(options);
        try {
            generate_scene(options);
        } catch (const Error& error) {
            EXPECT_EQ(error.status(), Status::invalid_argument);
            return error.what();
        }
        return "";
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    EXPECT_EQ(message([](auto& o) { o.num_images = 1; }), "num_images = 1, but it must be >= 2");
    EXPECT_EQ(message([](auto& o) { o.observations_per_image = 7; }),
              "observations_per_image = 7, but it must be >= 8");
    EXPECT_EQ(message([](auto& o) { o.kind = static_cast<SceneKind>(4); }),
              "scene = 4, but the scenes are 1 (hall), 2 (street) and 3 (landmark)");
    EXPECT_EQ(message([](auto& o) { o.num_points = -5; }),
              "num_points = -5, but it must be >= 1, or 0 to follow from the observations");
    EXPECT_EQ(message([](auto& o) { o.outlier_share = 1.5; }),
              "outlier_share = 1.5, but it must be from 0 to 1");
    EXPECT_EQ(message([](auto& o) { o.pixel_noise = -1; }),
              "pixel_noise = -1, but it must be finite and >= 0");
    EXPECT_EQ(message([=](auto& o) { o.rotation_noise = nan; }),
              "rotation_noise = nan, but it must be finite and >= 0");
    EXPECT_NE(message([](auto& o) { o.position_noise = -1; }), "");
    EXPECT_NE(message([](auto& o) { o.point_noise = -1; }), "");
    EXPECT_NE(message([](auto& o) {
                  o.num_images = 2000000000;
                  o.observations_per_image = 2000000000;
              }),
              "");
}

}  // namespace
}  // namespace clba
