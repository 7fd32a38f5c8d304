// SPDX-License-Identifier: Apache-2.0
#include "reference/camera_models.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <iterator>
#include <limits>
#include <utility>
#include <vector>

#include "test_problems.hpp"

namespace clba {
namespace {

using reference::is_singular;
using reference::project;
using reference::projection_derivatives;

constexpr double epsilon = std::numeric_limits<double>::epsilon();

int front_sign(int32_t model) {
    return reference::with_camera_model(model,
                                        [](auto camera) { return decltype(camera)::front_sign; });
}

Camera camera_with(int32_t model, const std::vector<double>& params) {
    Camera camera;
    camera.model = model;
    for (size_t k = 0; k < params.size(); ++k) camera.params[k] = params[k];
    return camera;
}

// u = 0.25, v = 0.5, r2 = 0.3125 for every model.
const Camera hand_cameras[] = {
    camera_with(camera_snavely, {100, 0.1, 0.01}),
    camera_with(camera_simple_pinhole, {100, 10, 20}),
    camera_with(camera_pinhole, {100, 200, 10, 20}),
    camera_with(camera_simple_radial, {100, 10, 20, 0.1}),
    camera_with(camera_radial, {100, 10, 20, 0.1, 0.01}),
    camera_with(camera_opencv, {100, 200, 10, 20, 0.1, 0.01, 0.001, 0.002}),
};
const Eigen::Vector2d hand_pixels[] = {
    {25.8056640625, 51.611328125},
    {35, 70},
    {35, 120},
    {35.78125, 71.5625},
    {35.8056640625, 71.611328125},
    {35.9181640625, 123.48515625},
};

TEST(CameraModel, PixelsEqualHandNumbers) {
    ASSERT_EQ(std::size(hand_cameras), static_cast<size_t>(num_camera_models));
    for (int32_t model = 0; model < num_camera_models; ++model) {
        SCOPED_TRACE(camera_models[model].name);
        ASSERT_EQ(hand_cameras[model].model, model);
        const auto projection = project(hand_cameras[model], {1, 2, 4.0 * front_sign(model)});
        EXPECT_LE((projection.pixel - hand_pixels[model]).cwiseAbs().maxCoeff(), 8 * epsilon * 130);
        EXPECT_FALSE(projection.is_behind);
        EXPECT_FALSE(projection.is_singular);
    }
}

TEST(CameraModel, OnlySnavelyLooksAlongNegativeZ) {
    for (int32_t model = 0; model < num_camera_models; ++model)
        EXPECT_EQ(front_sign(model), model == camera_snavely ? -1 : 1) << camera_models[model].name;
}

TEST(CameraModel, PointsBehindFollowTheFormula) {
    const auto behind = project(hand_cameras[camera_simple_pinhole], {1, 2, -4});
    EXPECT_TRUE(behind.is_behind);
    EXPECT_FALSE(behind.is_singular);
    EXPECT_EQ(behind.pixel, Eigen::Vector2d(100 * -0.25 + 10, 100 * -0.5 + 20));
    EXPECT_TRUE(project(hand_cameras[camera_snavely], {1, 2, 4}).is_behind);
}

TEST(CameraModel, DerivativesEqualCentralDifferences) {
    for (int32_t model = 0; model < num_camera_models; ++model) {
        for (const auto& [u, v] :
             {std::pair(0.0, 0.0), std::pair(0.25, 0.5), std::pair(-0.7, 0.6)}) {
            SCOPED_TRACE(testing::Message()
                         << camera_models[model].name << " at " << u << ", " << v);
            const Camera& camera = hand_cameras[model];
            const double z = 4.0 * front_sign(model);
            const Eigen::Vector3d p(4 * u, 4 * v, z);
            const auto derivatives = projection_derivatives(camera, p);
            // Error of the difference: epsilon |pixel| / step, and step^4 |pixel| / 30.
            const double step = std::pow(epsilon, 0.2);
            const double tolerance = 10 * 200 * epsilon / step;
            for (int k = 0; k < 3; ++k) {
                const auto moved = [&](double h) {
                    return project(camera, p + h * Eigen::Vector3d::Unit(k)).pixel;
                };
                const Eigen::Vector2d difference = test::central_difference(moved, step);
                EXPECT_LE((derivatives.point.col(k) - difference).norm(), tolerance)
                    << "axis " << k;
            }
            for (int k = 0; k < max_camera_params; ++k) {
                if (k >= camera.num_params()) {
                    EXPECT_TRUE(derivatives.params.col(k).isZero(0)) << "parameter " << k;
                    continue;
                }
                const auto moved = [&](double h) {
                    Camera other = camera;
                    other.params[k] += h;
                    return project(other, p).pixel;
                };
                const Eigen::Vector2d difference = test::central_difference(moved, step);
                EXPECT_LE((derivatives.params.col(k) - difference).norm(), tolerance)
                    << "parameter " << k;
            }
        }
    }
}

TEST(CameraModel, SingularMeansInTheCamerasOwnPlane) {
    EXPECT_TRUE(is_singular(0, 0, 0));
    EXPECT_TRUE(is_singular(1, 0.5, 0));
    EXPECT_TRUE(is_singular(-1, 1, 1.9e-10));
    EXPECT_TRUE(is_singular(1e6, -1e6, -1.9e-4));
    EXPECT_FALSE(is_singular(-1, 1, 2.1e-10));
    EXPECT_FALSE(is_singular(0, 0, 1e-300));
    EXPECT_FALSE(is_singular(0, 0, -1e-300));
}

TEST(CameraModel, SingularPointsShowThePrincipalPointAndHaveNoDerivative) {
    const Eigen::Vector2d principal_points[] = {{0, 0},   {10, 20}, {10, 20},
                                                {10, 20}, {10, 20}, {10, 20}};
    for (int32_t model = 0; model < num_camera_models; ++model) {
        for (const Eigen::Vector3d& p : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(1, -2, 0),
                                         Eigen::Vector3d(1, -2, -1e-12)}) {
            SCOPED_TRACE(camera_models[model].name);
            const auto projection = project(hand_cameras[model], p);
            EXPECT_EQ(projection.pixel, principal_points[model]);
            EXPECT_TRUE(projection.is_singular);
            EXPECT_FALSE(projection.is_behind);
            const auto derivatives = projection_derivatives(hand_cameras[model], p);
            EXPECT_TRUE(derivatives.point.isZero(0));
            EXPECT_TRUE(derivatives.params.isZero(0));
        }
    }
}

TEST(CameraModel, AnUnknownModelIsAnError) {
    Camera camera;
    camera.model = num_camera_models;
    try {
        project(camera, {0, 0, 1});
        FAIL() << "no error";
    } catch (const Error& error) {
        EXPECT_EQ(error.status(), Status::internal);
    }
}

}  // namespace
}  // namespace clba
