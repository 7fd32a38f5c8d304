// SPDX-License-Identifier: Apache-2.0
#include "reference/compare.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "base/error.hpp"
#include "reference/scene.hpp"

namespace clba {
namespace {

constexpr double epsilon = std::numeric_limits<double>::epsilon();

Point rotated(const std::array<double, 9>& r, const Point& x) {
    Point y;
    for (int k = 0; k < 3; ++k) y[k] = r[3 * k] * x[0] + r[3 * k + 1] * x[1] + r[3 * k + 2] * x[2];
    return y;
}

void place_center(Pose& pose, const Point& center) {
    const Point rotated_center = rotated(rotation_matrix(pose.rotation), center);
    for (int k = 0; k < 3; ++k) pose.translation[k] = -rotated_center[k];
}

// X -> scale Q X + shift.
Problem moved(Problem problem, double scale, const std::array<double, 3>& turn,
              const Point& shift) {
    const auto q = quaternion_from_rotation_vector(turn);
    const auto matrix = rotation_matrix(q);
    const auto move = [&](const Point& x) {
        Point y = rotated(matrix, x);
        for (int k = 0; k < 3; ++k) y[k] = scale * y[k] + shift[k];
        return y;
    };
    for (Image& image : problem.images) {
        const Point center = move(camera_center(image.pose));
        image.pose.rotation =
            normalized(quaternion_product(image.pose.rotation, {q[0], -q[1], -q[2], -q[3]}));
        place_center(image.pose, center);
    }
    for (Point& point : problem.points) point = move(point);
    return problem;
}

Problem with_centers(const std::vector<Point>& centers, const std::vector<Point>& points) {
    Problem problem;
    for (const Point& center : centers) {
        Image image;
        image.camera = problem.num_cameras();
        image.pose.rotation = quaternion_from_rotation_vector({0.1, 0.2, 0.3});
        place_center(image.pose, center);
        problem.images.push_back(image);
        problem.cameras.emplace_back();
    }
    problem.points = points;
    return problem;
}

void expect_equal_up_to_similarity(const Problem& problem, double size) {
    const double scale = 2.5;
    const Problem other = moved(problem, scale, {0.5, -1.0, 0.7}, {10, -20, 5});
    const Comparison comparison = compare(problem, other);
    const double tolerance = 1000 * epsilon * (size + 30);
    EXPECT_NEAR(comparison.scale, 1 / scale, tolerance);
    EXPECT_LT(comparison.max_center_distance, tolerance);
    EXPECT_LT(comparison.max_point_distance, tolerance);
    EXPECT_LE(comparison.median_center_distance, comparison.max_center_distance);
    EXPECT_LE(comparison.median_point_distance, comparison.max_point_distance);
}

TEST(CompareTest, SimilarCopiesAreEqual) {
    for (SceneKind kind : {SceneKind::hall, SceneKind::street, SceneKind::landmark}) {
        SCOPED_TRACE(static_cast<int>(kind));
        SceneOptions options;
        options.kind = kind;
        options.num_images = 40;
        options.observations_per_image = 50;
        expect_equal_up_to_similarity(generate_scene(options).truth, 100);
    }
}

TEST(CompareTest, MeasuresWhatIsLeft) {
    // Moved out of their plane so that no similarity can follow: the best rotation is the identity.
    const Problem a = with_centers({{2, 0, 0}, {-2, 0, 0}, {0, 2, 0}, {0, -2, 0}},
                                   {{0, 0, 1}, {0, 0, 2}, {0, 0, 3}});
    const Problem b = with_centers({{2, 0, 0.5}, {-2, 0, 0.5}, {0, 2, -0.5}, {0, -2, -0.5}},
                                   {{0, 0, 1}, {0, 1, 2}, {3, 0, 3}});
    const Comparison comparison = compare(a, b);
    // Umeyama's scale: sum a.b / sum |b - mean|^2 = 16 / 17.
    const double scale = 16.0 / 17;
    const double center = std::hypot(2 - 2 * scale, 0.5 * scale);
    const double tolerance = 100 * epsilon;
    EXPECT_NEAR(comparison.scale, scale, tolerance);
    EXPECT_NEAR(comparison.max_center_distance, center, tolerance);
    EXPECT_NEAR(comparison.median_center_distance, center, tolerance);
    EXPECT_NEAR(comparison.max_point_distance, std::hypot(3 * scale, 3 - 3 * scale), tolerance);
    EXPECT_NEAR(comparison.median_point_distance, std::hypot(scale, 2 - 2 * scale), tolerance);
    EXPECT_NEAR(comparison.extent, 2, tolerance);
}

TEST(CompareTest, MedianOfAnEvenNumberLiesBetween) {
    const std::vector<Point> centers = {{2, 0, 0}, {-2, 0, 0}, {0, 2, 0}, {0, -2, 0}};
    const Problem a = with_centers(centers, {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}});
    const Problem b = with_centers(centers, {{9, 0, 0}, {0, 1, 0}, {0, 0, 4}, {2, 0, 0}});
    EXPECT_NEAR(compare(a, b).median_point_distance, 3, 100 * epsilon);
    EXPECT_NEAR(compare(a, b).max_point_distance, 9, 100 * epsilon);
}

TEST(CompareTest, PointsHelpWhereCentersDoNotFixASimilarity) {
    const std::vector<Point> points = {{0, 0, 1}, {3, 0, 2}, {0, 5, 3}, {1, 1, 1}};
    expect_equal_up_to_similarity(with_centers({{1, 2, 3}, {4, 5, 7}}, points), 10);
    expect_equal_up_to_similarity(with_centers({{1, 2, 3}}, points), 10);
    expect_equal_up_to_similarity(with_centers({}, points), 10);
    expect_equal_up_to_similarity(
        with_centers({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}}, points), 10);
    expect_equal_up_to_similarity(with_centers({{1, 1, 1}, {1, 1, 1}, {1, 1, 1}}, points), 10);
}

// A street that is straight to a thousandth: noise of the centres must not turn it about its axis.
TEST(CompareTest, NearlyCollinearCentersDoNotTurnThePoints) {
    std::vector<Point> centers, noisy, points;
    for (int i = 0; i < 100; ++i) {
        centers.push_back({1.0 * i, 0.01 * std::sin(i), 0});
        noisy.push_back({1.0 * i, 0, 0.01 * std::sin(i)});
        points.push_back({1.0 * i, i % 2 ? 8.0 : -8.0, 0});
    }
    const Comparison comparison =
        compare(with_centers(centers, points), with_centers(noisy, points));
    EXPECT_LT(comparison.max_point_distance, 0.01);
}

TEST(CompareTest, ComparesWithoutImagesOrPoints) {
    const Comparison nothing = compare(Problem(), Problem());
    EXPECT_EQ(nothing.scale, 1);
    EXPECT_EQ(nothing.max_center_distance, 0);
    EXPECT_EQ(nothing.median_point_distance, 0);
    EXPECT_EQ(nothing.extent, 0);
    const Problem one = with_centers({{1, 2, 3}}, {});
    const Problem other = with_centers({{4, 5, 6}}, {});
    EXPECT_EQ(compare(one, other).scale, 1);
    EXPECT_LT(compare(one, other).max_center_distance, 100 * epsilon);
}

TEST(CompareTest, RejectsDifferentCounts) {
    const auto message = [](const Problem& a, const Problem& b) -> std::string {
        try {
            compare(a, b);
        } catch (const Error& error) {
            EXPECT_EQ(error.status(), Status::invalid_argument);
            return error.what();
        }
        return "";
    };
    const Problem problem = with_centers({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{1, 1, 1}});
    EXPECT_EQ(message(problem, with_centers({{0, 0, 0}}, {{1, 1, 1}})),
              "a has 3 images and b has 1, but images are compared by index");
    EXPECT_EQ(message(with_centers({}, {}), with_centers({}, {{1, 1, 1}, {2, 2, 2}})),
              "a has 0 points and b has 2, but points are compared by index");
}

}  // namespace
}  // namespace clba
