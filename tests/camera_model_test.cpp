// SPDX-License-Identifier: Apache-2.0
#include "reference/camera_models.hpp"

#include <gtest/gtest.h>

#include <algorithm>
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
    camera_with(camera_opencv_fisheye, {100, 200, 10, 20, 0.1, 0.01, 0.02, 0.03}),
    camera_with(camera_full_opencv,
                {100, 200, 10, 20, 0.1, 0.01, 0.001, 0.002, 0.02, 0.03, 0.004, 0.005}),
    camera_with(camera_fov, {100, 200, 10, 20, 0.9}),
    camera_with(camera_simple_radial_fisheye, {100, 10, 20, 0.1}),
    camera_with(camera_radial_fisheye, {100, 10, 20, 0.1, 0.01}),
    camera_with(camera_thin_prism_fisheye,
                {100, 200, 10, 20, 0.1, 0.01, 0.001, 0.002, 0.02, 0.03, 0.003, 0.004}),
    camera_with(camera_brown, {100, 10, 20, 0.1, 0.01, 0.2, 0.001, 0.002}),
};
const Eigen::Vector2d hand_pixels[] = {
    {25.8056640625, 51.611328125},
    {35, 70},
    {35, 120},
    {35.78125, 71.5625},
    {35.8056640625, 71.611328125},
    {35.9181640625, 123.48515625},
    {33.41508276746445, 113.66033106985778},
    {35.6798405251866, 122.53186210074638},
    {34.60613886585088, 118.42455546340351},
    {33.388576805348144, 66.77715361069629},
    {33.40396746388031, 66.80793492776063},
    {33.58657356398011, 114.08645971574519},
    {36.070751953125, 72.04775390625},
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
    for (int32_t model = camera_opencv_fisheye; model < num_camera_models; ++model) {
        const auto of_fisheye = project(hand_cameras[model], {1, 2, -4});
        EXPECT_TRUE(of_fisheye.is_behind);
        EXPECT_EQ(of_fisheye.pixel, project(hand_cameras[model], {-1, -2, 4}).pixel);
    }
}

// Against the quotients themselves, in more digits than double has.
TEST(CameraModel, RatiosOfAnglesLoseNoDigits) {
    static_assert(std::numeric_limits<long double>::digits > 53);
    for (double exponent = -18; exponent <= 18; exponent += 0.01) {
        const double r2 = std::pow(10, exponent);
        const long double r = std::sqrt(static_cast<long double>(r2));
        const auto wanted = static_cast<double>(std::atan(r) / r);
        EXPECT_NEAR(reference::angle_ratio(r2), wanted, 4 * epsilon * wanted) << r2;
    }
    EXPECT_EQ(reference::angle_ratio(0.0), 1);
    for (double h = -1.5; h <= 1.5; h += 0.001) {
        const long double exact = h;
        const auto wanted = static_cast<double>(h == 0 ? 1 : std::tan(exact) / exact);
        EXPECT_NEAR(reference::tangent_ratio(h), wanted, 4 * epsilon * wanted) << h;
    }
    EXPECT_EQ(reference::tangent_ratio(0.0), 1);
}

TEST(CameraModel, FovWithoutDistortionIsAPinhole) {
    Camera camera = hand_cameras[camera_fov];
    camera.params[4] = 0;
    const Eigen::Vector3d p(1, 2, 4);
    EXPECT_EQ(project(camera, p).pixel, project(hand_cameras[camera_pinhole], p).pixel);
    const auto derivatives = projection_derivatives(camera, p);
    EXPECT_TRUE(derivatives.params.col(4).isZero(0));
    EXPECT_EQ(derivatives.point, projection_derivatives(hand_cameras[camera_pinhole], p).point);
}

TEST(CameraModel, DerivativesEqualCentralDifferences) {
    const double edge = std::sqrt(3.0);  // 60 degrees from the axis
    for (int32_t model = 0; model < num_camera_models; ++model) {
        for (const auto& [u, v] :
             {std::pair(0.0, 0.0), std::pair(1e-9, 0.0), std::pair(-1e-9, 1e-9),
              std::pair(0.25, 0.5), std::pair(-0.7, 0.6), std::pair(0.6 * edge, -0.8 * edge)}) {
            SCOPED_TRACE(testing::Message()
                         << camera_models[model].name << " at " << u << ", " << v);
            const Camera& camera = hand_cameras[model];
            const double z = 4.0 * front_sign(model);
            const Eigen::Vector3d p(4 * u, 4 * v, z);
            const auto derivatives = projection_derivatives(camera, p);
            // Error of the difference: epsilon |pixel| / step, and step^4 |pixel| / 30.
            const double step = std::pow(epsilon, 0.2);
            const double size = std::max(200.0, project(camera, p).pixel.norm());
            const double tolerance = 10 * size * epsilon / step;
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
                // Of a power of r2 it moves the pixel by much: a step for the same move.
                const double share = std::min(1.0, 100 / derivatives.params.col(k).norm());
                const Eigen::Vector2d difference = test::central_difference(moved, share * step);
                EXPECT_LE((derivatives.params.col(k) - difference).norm(), tolerance / share)
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
    const auto principal_point = [](int32_t model) {
        return model == camera_snavely ? Eigen::Vector2d(0, 0) : Eigen::Vector2d(10, 20);
    };
    for (int32_t model = 0; model < num_camera_models; ++model) {
        for (const Eigen::Vector3d& p : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(1, -2, 0),
                                         Eigen::Vector3d(1, -2, -1e-12)}) {
            SCOPED_TRACE(camera_models[model].name);
            const auto projection = project(hand_cameras[model], p);
            EXPECT_EQ(projection.pixel, principal_point(model));
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
