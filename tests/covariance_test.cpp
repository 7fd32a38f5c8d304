// SPDX-License-Identifier: Apache-2.0
// Covariances through the C interface, against the dense inverse of what clba_problem_evaluate
// gives, with the gauge's conditions as Lagrange's multipliers; and moving a state's gauge.
#include <clba/clba.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <functional>
#include <limits>
#include <vector>

#include "api_rig.hpp"

namespace clba_test {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double infinity = std::numeric_limits<double>::infinity();

struct ReleaseCovariance {
    void operator()(clba_covariance* covariance) const { clba_covariance_release(covariance); }
};
using Covariance = std::unique_ptr<clba_covariance, ReleaseCovariance>;

clba_covariance_options covariance_options(int32_t gauge = CLBA_GAUGE_DEFAULT) {
    clba_covariance_options options;
    EXPECT_OK(clba_covariance_options_init(&options, sizeof options));
    options.gauge = gauge;
    options.all_points = 1;
    return options;
}

Covariance covariance_of(const Problem& problem, const Context& context,
                         const clba_covariance_options& options) {
    clba_covariance* covariance = nullptr;
    EXPECT_OK(clba_problem_covariance(problem.get(), context.get(), &options, &covariance));
    return Covariance(covariance);
}

clba_covariance_info info_of(const Covariance& covariance) {
    clba_covariance_info info;
    info.struct_size = sizeof info;
    EXPECT_OK(clba_covariance_get_info(covariance.get(), &info));
    return info;
}

MatrixXd block_of(const Covariance& covariance, int32_t block, int64_t row, int size,
                  MatrixXd* errors = nullptr) {
    RowMajor values(size, size), of_values(size, size);
    EXPECT_OK(
        clba_covariance_get(covariance.get(), block, row, 1, values.data(), of_values.data(), 0));
    if (errors) *errors = of_values;
    return values;
}

Matrix3d rotation_of(const double* pose) {
    return Eigen::Quaterniond(pose[0], pose[1], pose[2], pose[3]).toRotationMatrix();
}

// The problem's numbers and the dense Jacobian, whose columns are 0 where there is nothing to find.
struct Dense {
    Dense(const Problem& problem, const Context& context)
        : data(data_of(problem)), info(clba_test::info_of(problem)) {
        pose_offsets.resize(static_cast<size_t>(info.num_images));
        intrinsics_offsets.resize(static_cast<size_t>(info.num_cameras));
        EXPECT_OK(clba_problem_get_offsets(problem.get(), pose_offsets.data(),
                                           intrinsics_offsets.data()));
        const int64_t n = info.num_observations, width = info.num_parameters_per_image_block;
        std::vector<double> images(static_cast<size_t>(2 * n * width));
        std::vector<double> points(static_cast<size_t>(6 * n));
        clba_evaluation evaluation;
        EXPECT_OK(clba_evaluation_init(&evaluation, sizeof evaluation));
        evaluation.jacobian_images = images.data();
        evaluation.jacobian_points = points.data();
        EXPECT_OK(clba_problem_evaluate(problem.get(), context.get(), &evaluation));
        cost = evaluation.cost;
        jacobian = MatrixXd::Zero(2 * n, info.num_parameters);
        for (int64_t i = 0; i < n; ++i) {
            const int32_t image = data.images[i], camera = data.cameras[image];
            const int num_params = clba_camera_model_num_params(data.models[camera]);
            for (int64_t row = 2 * i; row < 2 * i + 2; ++row) {
                for (int k = 0; k < 6 + num_params; ++k)
                    jacobian(row,
                             k < 6 ? pose_offsets[image] + k : intrinsics_offsets[camera] + k - 6) =
                        images[row * width + k];
                for (int k = 0; k < 3; ++k)
                    jacobian(row, point_offset(data.points[i]) + k) = points[3 * row + k];
            }
        }
    }

    int64_t point_offset(int32_t point) const {
        return info.num_image_camera_parameters + 3 * int64_t{point};
    }
    Matrix3d rotation(int32_t image) const { return rotation_of(&data.poses[7 * image]); }
    Vector3d center(int32_t image) const {
        return -rotation(image).transpose() * Vector3d(&data.poses[7 * image + 4]);
    }
    Vector3d point(int32_t p) const { return Vector3d(&data.xyz[3 * p]); }

    // [H C; C^T 0]^-1, its part of H, without the columns of J that are 0 or left out.
    void invert(const MatrixXd& constraints, const std::vector<int64_t>& left_out = {}) {
        std::vector<Eigen::Index> kept;
        for (Eigen::Index k = 0; k < jacobian.cols(); ++k)
            if (jacobian.col(k).cwiseAbs().maxCoeff() > 0 &&
                std::find(left_out.begin(), left_out.end(), k) == left_out.end())
                kept.push_back(k);
        const auto n = static_cast<Eigen::Index>(kept.size()), m = constraints.cols();
        // Columns of equal size, as they differ by many orders.
        Eigen::VectorXd scale(n);
        for (Eigen::Index k = 0; k < n; ++k) scale[k] = 1 / jacobian.col(kept[k]).norm();
        const MatrixXd scaled = jacobian(Eigen::all, kept) * scale.asDiagonal();
        MatrixXd whole = MatrixXd::Zero(n + m, n + m);
        whole.topLeftCorner(n, n) = scaled.transpose() * scaled;
        MatrixXd held = scale.asDiagonal() * constraints(kept, Eigen::all);
        for (Eigen::Index k = 0; k < m; ++k) held.col(k).normalize();
        whole.topRightCorner(n, m) = held;
        whole.bottomLeftCorner(m, n) = held.transpose();
        const MatrixXd inverse = whole.fullPivLu().inverse();
        covariance = MatrixXd::Zero(jacobian.cols(), jacobian.cols());
        covariance(kept, kept) =
            scale.asDiagonal() * inverse.topLeftCorner(n, n) * scale.asDiagonal();
        num_kept = n;
    }

    MatrixXd first_image_and_baseline(const int32_t* images) const {
        MatrixXd constraints = MatrixXd::Zero(jacobian.cols(), 7);
        constraints.block<6, 6>(pose_offsets[images[0]], 0).setIdentity();
        constraints.block<3, 1>(pose_offsets[images[1]] + 3, 6) =
            rotation(images[1]) * (center(images[1]) - center(images[0])).normalized();
        return constraints;
    }
    MatrixXd three_points(const int32_t* points) const {
        MatrixXd constraints = MatrixXd::Zero(jacobian.cols(), 7);
        constraints.block<3, 3>(point_offset(points[0]), 0).setIdentity();
        constraints.block<3, 3>(point_offset(points[1]), 3).setIdentity();
        constraints.block<3, 1>(point_offset(points[2]), 6) =
            (point(points[1]) - point(points[0])).cross(point(points[2]) - point(points[0]));
        return constraints;
    }
    // The motion of all centres by a translation, a rotation and a change of scale.
    MatrixXd inner() const {
        MatrixXd constraints = MatrixXd::Zero(jacobian.cols(), 7);
        for (int32_t i = 0; i < info.num_images; ++i) {
            Eigen::Matrix<double, 3, 7> motion;
            motion.leftCols<3>().setIdentity();
            for (int k = 0; k < 3; ++k)
                motion.col(3 + k) = Vector3d::Unit(k).cross(center(i) - center(0));
            motion.col(6) = center(i) - center(0);
            constraints.middleRows<3>(pose_offsets[i] + 3) = -rotation(i) * motion;
        }
        return constraints;
    }

    Data data;
    clba_problem_info info;
    std::vector<int64_t> pose_offsets, intrinsics_offsets;
    MatrixXd jacobian, covariance;
    double cost = 0;
    Eigen::Index num_kept = 0;
};

// Largest difference in units of the standard deviations.
double difference(const MatrixXd& got, const MatrixXd& expected) {
    double largest = 0;
    for (Eigen::Index i = 0; i < got.rows(); ++i) {
        for (Eigen::Index j = 0; j < got.cols(); ++j) {
            const double unit = std::sqrt(expected(i, i) * expected(j, j));
            const double error = std::abs(got(i, j) - expected(i, j));
            if (!(error <= largest * unit)) largest = unit > 0 ? error / unit : infinity;
        }
    }
    return largest;
}

constexpr double tolerance = 1e-6;

// Every block but those that are infinite.
void expect_equal(const Covariance& covariance, const Dense& dense) {
    const clba_covariance_info info = info_of(covariance);
    double poses = 0, centers = 0, intrinsics = 0, joints = 0, points = 0;
    int num_finite = 0;
    for (int32_t i = 0; i < info.num_images; ++i) {
        const int32_t camera = dense.data.cameras[i];
        const int n = clba_camera_model_num_params(dense.data.models[camera]);
        std::vector<Eigen::Index> rows;
        for (int k = 0; k < 6; ++k) rows.push_back(dense.pose_offsets[i] + k);
        for (int k = 0; k < n; ++k) rows.push_back(dense.intrinsics_offsets[camera] + k);
        MatrixXd joint = dense.covariance(rows, rows);
        // What is held has variances of rounding here, and of 0 there.
        for (int k = 0; k < 6; ++k) {
            if (i != info.gauge_images[0]) continue;
            joint.row(k).setZero();
            joint.col(k).setZero();
        }
        const auto pose = joint.topLeftCorner<6, 6>();
        const MatrixXd center =
            dense.rotation(i).transpose() * pose.bottomRightCorner<3, 3>() * dense.rotation(i);
        const MatrixXd got = block_of(covariance, CLBA_BLOCK_POSE, i, 6);
        if (std::isinf(got(0, 0))) continue;
        poses = std::max(poses, difference(got, pose));
        centers =
            std::max(centers, difference(block_of(covariance, CLBA_BLOCK_CENTER, i, 3), center));
        const MatrixXd of_camera = block_of(covariance, CLBA_BLOCK_INTRINSICS, camera, n);
        intrinsics = std::max(intrinsics, difference(of_camera, joint.bottomRightCorner(n, n)));
        const MatrixXd got_joint = block_of(covariance, CLBA_BLOCK_POSE_AND_INTRINSICS, i, 6 + n);
        joints = std::max(joints, difference(got_joint, joint));
        ++num_finite;
    }
    EXPECT_GT(num_finite, 2);
    num_finite = 0;
    for (int32_t p = 0; p < info.num_points; ++p) {
        const MatrixXd got = block_of(covariance, CLBA_BLOCK_POINT, p, 3);
        if (std::isinf(got(0, 0))) continue;
        const Eigen::Index at = dense.point_offset(p);
        const bool is_held =
            std::find(info.gauge_points, info.gauge_points + 2, p) != info.gauge_points + 2;
        // Nothing to compare but rounding.
        if (!is_held)
            points = std::max(points, difference(got, dense.covariance.block<3, 3>(at, at)));
        ++num_finite;
    }
    EXPECT_GT(num_finite, 20);
    EXPECT_LT(poses, tolerance);
    EXPECT_LT(centers, tolerance);
    EXPECT_LT(intrinsics, tolerance);
    EXPECT_LT(joints, tolerance);
    EXPECT_LT(points, tolerance);
}

// The precision of covariances: kernels of no other are compiled.
clba_solver_options solver_options_in_double() {
    clba_solver_options options = converged_options();
    options.precision = CLBA_PRECISION_DOUBLE;
    return options;
}

class Covariances : public testing::Test {
protected:
    Covariances() : context(make_context()), scene(generate()) {}

    // At the optimum of the start.
    Problem solved() const {
        Problem problem = problem_of(data_of(scene.start));
        solve(problem, context, solver_options_in_double());
        return problem;
    }
    void expect_refused(const Problem& problem, const clba_covariance_options& options,
                        std::initializer_list<const char*> parts) const {
        clba_covariance* covariance = nullptr;
        EXPECT_TRUE(refused(
            clba_problem_covariance(problem.get(), context.get(), &options, &covariance), parts));
        EXPECT_EQ(covariance, nullptr);
    }

    Context context;
    Scene scene;
};

TEST_F(Covariances, EqualTheDenseInverseInEachGauge) {
    const Problem problem = solved();
    Dense dense(problem, context);
    {
        SCOPED_TRACE("default");
        const Covariance covariance = covariance_of(problem, context, covariance_options());
        const clba_covariance_info info = info_of(covariance);
        EXPECT_EQ(info.gauge, CLBA_GAUGE_FIRST_IMAGE_AND_BASELINE);
        EXPECT_EQ(info.gauge_images[0], 0);
        EXPECT_EQ(info.num_freedoms, 7);
        EXPECT_EQ(info.method, CLBA_COVARIANCE_EXACT);
        dense.invert(dense.first_image_and_baseline(info.gauge_images));
        expect_equal(covariance, dense);
        EXPECT_EQ(block_of(covariance, CLBA_BLOCK_POSE, 0, 6), (MatrixXd::Zero(6, 6)));
        EXPECT_EQ(info.redundancy, dense.jacobian.rows() - dense.num_kept + 7);
        EXPECT_NEAR(info.variance_factor, 2 * dense.cost / static_cast<double>(info.redundancy),
                    1e-9);
    }
    {
        SCOPED_TRACE("named images");
        clba_covariance_options options = covariance_options(CLBA_GAUGE_FIRST_IMAGE_AND_BASELINE);
        options.gauge_images[0] = 5;
        options.gauge_images[1] = 2;
        const Covariance covariance = covariance_of(problem, context, options);
        dense.invert(dense.first_image_and_baseline(options.gauge_images));
        expect_equal(covariance, dense);
    }
    {
        SCOPED_TRACE("three points");
        clba_covariance_options options = covariance_options(CLBA_GAUGE_THREE_POINTS);
        const int32_t points[3] = {3, 11, 40};
        std::copy_n(points, 3, options.gauge_points);
        const Covariance covariance = covariance_of(problem, context, options);
        dense.invert(dense.three_points(points));
        expect_equal(covariance, dense);
    }
    {
        SCOPED_TRACE("inner");
        const Covariance covariance =
            covariance_of(problem, context, covariance_options(CLBA_GAUGE_INNER));
        dense.invert(dense.inner());
        expect_equal(covariance, dense);
    }
}

TEST_F(Covariances, OfSharedCamerasOtherModelsALossAndCovariances) {
    const Problem problem = problem_of(with_other_models(data_of(scene.start)));
    const clba_problem_info info = clba_test::info_of(problem);
    std::vector<double> covariances;
    for (int64_t i = 0; i < info.num_observations; ++i) {
        const double x = 0.3 + 0.1 * static_cast<double>(i % 7);
        covariances.insert(covariances.end(), {x, 0.1 * x, 1.5 * x});
    }
    ASSERT_OK(
        clba_problem_set_covariances(problem.get(), info.num_observations, covariances.data(), 0));
    ASSERT_OK(clba_problem_set_loss(problem.get(), CLBA_LOSS_CAUCHY, 1.5));
    solve(problem, context, solver_options_in_double());
    const Covariance covariance = covariance_of(problem, context, covariance_options());
    const clba_covariance_info of_covariance = info_of(covariance);
    Dense dense(problem, context);
    dense.invert(dense.first_image_and_baseline(of_covariance.gauge_images));
    expect_equal(covariance, dense);
    // Camera 2 is used by no image.
    EXPECT_EQ(of_covariance.num_undetermined_parameters, 3);
    const MatrixXd unused = block_of(covariance, CLBA_BLOCK_INTRINSICS, 2, 3);
    EXPECT_EQ(unused(0, 0), infinity);
    EXPECT_EQ(unused(0, 1), 0);
}

TEST_F(Covariances, ConstantsAreKnownAndHoldTheGauge) {
    const Problem problem = solved();
    std::vector<int32_t> images(8, 0), cameras(8, 0),
        points(clba_test::info_of(problem).num_points, 0);
    images[2] = CLBA_CONSTANT_POSE;
    cameras[3] = 0b101;
    points[7] = 0;
    ASSERT_OK(clba_problem_set_constant_images(problem.get(), 8, images.data(), 0));
    ASSERT_OK(clba_problem_set_constant_cameras(problem.get(), 8, cameras.data(), 0));
    {
        SCOPED_TRACE("the scale alone is free");
        const Covariance covariance = covariance_of(problem, context, covariance_options());
        const clba_covariance_info info = info_of(covariance);
        EXPECT_EQ(info.gauge, CLBA_GAUGE_FIRST_IMAGE_AND_BASELINE);
        EXPECT_EQ(info.gauge_images[0], 2);
        EXPECT_EQ(info.num_freedoms, 1);
        Dense dense(problem, context);
        dense.invert(dense.first_image_and_baseline(info.gauge_images).rightCols(1));
        expect_equal(covariance, dense);
        EXPECT_EQ(block_of(covariance, CLBA_BLOCK_INTRINSICS, 3, 3)(0, 0), 0);
        expect_refused(problem, covariance_options(CLBA_GAUGE_PROBLEM), {"1 of the 7"});
        clba_covariance_options other = covariance_options(CLBA_GAUGE_FIRST_IMAGE_AND_BASELINE);
        other.gauge_images[0] = 4;
        expect_refused(problem, other, {"would hold 7", "leaves 1"});
    }
    {
        SCOPED_TRACE("nothing is free");
        images[6] = CLBA_CONSTANT_POSITION;
        points[7] = 1;
        ASSERT_OK(clba_problem_set_constant_images(problem.get(), 8, images.data(), 0));
        ASSERT_OK(clba_problem_set_constant_points(
            problem.get(), static_cast<int32_t>(points.size()), points.data(), 0));
        const Covariance covariance = covariance_of(problem, context, covariance_options());
        EXPECT_EQ(info_of(covariance).gauge, CLBA_GAUGE_PROBLEM);
        EXPECT_EQ(info_of(covariance).num_freedoms, 0);
        Dense dense(problem, context);
        dense.invert(MatrixXd(dense.jacobian.cols(), 0));
        expect_equal(covariance, dense);
        EXPECT_EQ(block_of(covariance, CLBA_BLOCK_POINT, 7, 3), (MatrixXd::Zero(3, 3)));
        expect_refused(problem, covariance_options(CLBA_GAUGE_INNER), {"gauge = problem"});
    }
}

// Points seen once or never, and an image that sees nothing.
TEST_F(Covariances, WhatNothingDeterminesIsInfinite) {
    Data data = data_of(solved());
    const auto drop = [&](const std::function<bool(int32_t image, int32_t point)>& is_dropped) {
        size_t to = 0;
        for (size_t i = 0; i < data.images.size(); ++i) {
            if (is_dropped(data.images[i], data.points[i])) continue;
            data.images[to] = data.images[i];
            data.points[to] = data.points[i];
            data.xy[2 * to] = data.xy[2 * i];
            data.xy[2 * to + 1] = data.xy[2 * i + 1];
            ++to;
        }
        data.images.resize(to);
        data.points.resize(to);
        data.xy.resize(2 * to);
    };
    drop([](int32_t image, int32_t) { return image == 4; });
    std::vector<int> views(static_cast<size_t>(data.num_points()), 0);
    drop([&](int32_t, int32_t point) { return point == 5 || (point == 9 && ++views[9] > 1); });
    views.assign(views.size(), 0);
    for (const int32_t point : data.points) ++views[point];
    std::vector<int64_t> left_out;
    const Problem problem = problem_of(data);
    Dense dense(problem, context);
    int64_t num_undetermined = 0;
    for (int32_t p = 0; p < data.num_points(); ++p) {
        num_undetermined += views[p] < 2 ? 1 : 0;
        // A point seen once takes its two residuals, whichever two coordinates it has.
        if (views[p] == 1) left_out.push_back(dense.point_offset(p) + 2);
    }
    ASSERT_GE(num_undetermined, 2);

    const Covariance covariance = covariance_of(problem, context, covariance_options());
    const clba_covariance_info info = info_of(covariance);
    EXPECT_EQ(info.num_undetermined_parameters, 9);
    EXPECT_EQ(info.num_undetermined_points, num_undetermined);
    dense.invert(dense.first_image_and_baseline(info.gauge_images), left_out);
    expect_equal(covariance, dense);
    EXPECT_EQ(info.redundancy, dense.jacobian.rows() - dense.num_kept + 7);
    for (const int32_t point : {5, 9}) {
        const MatrixXd of_point = block_of(covariance, CLBA_BLOCK_POINT, point, 3);
        EXPECT_EQ(of_point(2, 2), infinity);
        EXPECT_EQ(of_point(2, 0), 0);
    }
    const MatrixXd unseen = block_of(covariance, CLBA_BLOCK_CENTER, 4, 3);
    EXPECT_EQ(unseen(1, 1), infinity);
    EXPECT_EQ(unseen(1, 0), 0);

    // Two observations do not determine nine parameters.
    int kept = 0;
    drop([&](int32_t image, int32_t) { return image == 6 && ++kept > 2; });
    expect_refused(problem_of(data), covariance_options(), {"image 6", "hold constant"});
}

TEST_F(Covariances, ChosenPointsAndTheVarianceFactor) {
    const Problem problem = solved();
    clba_covariance_options options = covariance_options(CLBA_GAUGE_INNER);
    const Covariance all = covariance_of(problem, context, options);
    const int32_t points[2] = {31, 4};
    options.all_points = 0;
    options.points = points;
    options.num_points = 2;
    options.apply_variance_factor = 1;
    const Covariance some = covariance_of(problem, context, options);
    const clba_covariance_info info = info_of(some);
    EXPECT_EQ(info.num_points, 2);
    EXPECT_EQ(info.variance_factor_is_applied, 1);
    EXPECT_NEAR(info.variance_factor, 0.25, 0.05);  // the scene's noise is half a pixel
    for (int k = 0; k < 2; ++k)
        EXPECT_LT(difference(block_of(some, CLBA_BLOCK_POINT, k, 3),
                             info.variance_factor * block_of(all, CLBA_BLOCK_POINT, points[k], 3)),
                  tolerance);
    EXPECT_LT(difference(block_of(some, CLBA_BLOCK_POSE, 3, 6),
                         info.variance_factor * block_of(all, CLBA_BLOCK_POSE, 3, 6)),
              tolerance);
}

TEST_F(Covariances, SampledOnesAreAsFarFromTheTruthAsTheySay) {
    const Problem problem = solved();
    clba_covariance_options options = covariance_options(CLBA_GAUGE_THREE_POINTS);
    const int32_t points[3] = {3, 11, 40};
    std::copy_n(points, 3, options.gauge_points);
    const Covariance exact = covariance_of(problem, context, options);
    options.method = CLBA_COVARIANCE_SAMPLED;
    options.num_samples = 100;
    double num = 0, num_inside = 0, squares = 0;
    // Errors of one run are much alike: every image shares those of the gauge.
    for (uint64_t seed = 0; seed < 10; ++seed) {
        options.seed = seed;
        const Covariance sampled = covariance_of(problem, context, options);
        const clba_covariance_info info = info_of(sampled);
        EXPECT_EQ(info.method, CLBA_COVARIANCE_SAMPLED);
        EXPECT_EQ(info.num_samples, 100);
        EXPECT_DOUBLE_EQ(info.relative_error, std::sqrt(2.0 / 100));
        const auto compare = [&](int32_t block, int64_t row, int size) {
            MatrixXd errors;
            const MatrixXd estimate = block_of(sampled, block, row, size, &errors);
            const MatrixXd truth = block_of(exact, block, row, size);
            if (std::isinf(truth(0, 0))) return;
            for (int i = 0; i < size; ++i) {
                for (int j = 0; j <= i; ++j) {
                    if (std::min(truth(i, i), truth(j, j)) < 1e-12 * truth.trace()) continue;
                    const double ratio = (estimate(i, j) - truth(i, j)) / errors(i, j);
                    EXPECT_LT(std::abs(ratio), 6) << block << ' ' << row << ' ' << i << ' ' << j;
                    num += 1;
                    num_inside += std::abs(ratio) < 2 ? 1 : 0;
                    squares += ratio * ratio;
                }
            }
        };
        for (int32_t i = 0; i < info.num_images; ++i) {
            compare(CLBA_BLOCK_POSE_AND_INTRINSICS, i, 9);
            compare(CLBA_BLOCK_CENTER, i, 3);
        }
        for (int32_t p = 0; p < info.num_points; ++p)
            if (std::find(points, points + 2, p) == points + 2) compare(CLBA_BLOCK_POINT, p, 3);
    }
    // 95 % of normal numbers, whose mean square is 1.
    EXPECT_GT(num_inside / num, 0.92);
    EXPECT_GT(squares / num, 0.75);
    EXPECT_LT(squares / num, 1.35);
}

TEST_F(Covariances, AutoSamplesWhereMemoryDoesNotSuffice) {
    const Problem problem = solved();
    clba_covariance_options options = covariance_options();
    options.max_bytes = 1000;
    options.num_samples = 2;
    EXPECT_EQ(info_of(covariance_of(problem, context, options)).method, CLBA_COVARIANCE_SAMPLED);
    options.max_linear_solver_iterations = 1;
    expect_refused(problem, options, {"max_linear_solver_iterations = 1"});
}

TEST_F(Covariances, RefusesWhatItCannotDo) {
    const Problem problem = solved();
    const auto refuses = [&](const std::function<void(clba_covariance_options&)>& change,
                             std::initializer_list<const char*> parts) {
        clba_covariance_options options = covariance_options();
        change(options);
        expect_refused(problem, options, parts);
    };
    using Options = clba_covariance_options;
    refuses([](Options& o) { o.gauge = 5; }, {"gauge = 5"});
    refuses([](Options& o) { o.method = 3; }, {"method = 3"});
    refuses([](Options& o) { o.gauge = CLBA_GAUGE_PROBLEM; }, {"7 of the 7", "hold a pose"});
    refuses([](Options& o) { o.gauge = CLBA_GAUGE_THREE_POINTS; }, {"gauge_points"});
    refuses([](Options& o) { o.gauge_images[0] = 8; }, {"image 8", "num_images = 8"});
    refuses([](Options& o) { o.gauge_images[0] = o.gauge_images[1] = 3; }, {"both 3"});
    refuses([](Options& o) { o.num_samples = 1; }, {"num_samples = 1"});
    refuses([](Options& o) { o.relative_error = 0; }, {"relative_error = 0"});
    refuses([](Options& o) { o.max_linear_solver_iterations = 0; },
            {"max_linear_solver_iterations = 0"});
    const int32_t points[2] = {3, 3}, far_points[1] = {100000};
    refuses(
        [&](Options& o) {
            o.all_points = 0;
            o.points = points;
            o.num_points = 2;
        },
        {"points[1] = 3"});
    refuses(
        [&](Options& o) {
            o.all_points = 0;
            o.points = far_points;
            o.num_points = 1;
        },
        {"points[0] = 100000"});
    Data none = data_of(problem);
    none.images.clear();
    none.points.clear();
    none.xy.clear();
    expect_refused(problem_of(none), covariance_options(), {"no observations"});

    const Covariance covariance = covariance_of(problem, context, covariance_options());
    double values[36];
    EXPECT_TRUE(
        refused(clba_covariance_get(covariance.get(), 0, 0, 1, values, nullptr, 0), {"block = 0"}));
    EXPECT_TRUE(
        refused(clba_covariance_get(covariance.get(), CLBA_BLOCK_POSE, 8, 1, values, nullptr, 0),
                {"there are 8"}));
    EXPECT_TRUE(
        refused(clba_covariance_get(covariance.get(), CLBA_BLOCK_POSE, 0, 1, values, nullptr, 8),
                {"stride of 8"}));
}

TEST_F(Covariances, FixGaugeMovesTheStateAndNoResidual) {
    const Problem problem = solved();
    const double cost = cost_of(problem, context);
    const Data truth = data_of(scene.truth);
    const Dense of_truth(scene.truth, context);
    clba_gauge_target target;
    ASSERT_OK(clba_gauge_target_init(&target, sizeof target));
    target.images[0] = 3;
    target.images[1] = 6;
    target.pose = truth.poses.data() + 21;
    target.baseline = (of_truth.center(6) - of_truth.center(3)).norm();
    ASSERT_OK(clba_problem_fix_gauge(problem.get(), &target));
    {
        const Dense moved(problem, context);
        // Its quaternion is normalised.
        for (size_t k = 0; k < 7; ++k) EXPECT_NEAR(moved.data.poses[21 + k], target.pose[k], 1e-14);
        EXPECT_NEAR((moved.center(6) - moved.center(3)).norm(), target.baseline,
                    1e-12 * target.baseline);
        EXPECT_NEAR(moved.cost, cost, 1e-9 * cost);
    }
    const int32_t points[3] = {3, 11, 40};
    target.gauge = CLBA_GAUGE_THREE_POINTS;
    std::copy_n(points, 3, target.points);
    double xyz[9];
    for (int k = 0; k < 3; ++k) std::copy_n(&truth.xyz[3 * points[k]], 3, xyz + 3 * k);
    target.xyz = xyz;
    ASSERT_OK(clba_problem_fix_gauge(problem.get(), &target));
    {
        const Dense moved(problem, context);
        for (int k = 0; k < 2; ++k)
            EXPECT_LT((moved.point(points[k]) - of_truth.point(points[k])).norm(), 1e-10);
        const Vector3d normal =
            of_truth.three_points(points).block<3, 1>(of_truth.point_offset(points[2]), 6);
        EXPECT_NEAR(normal.normalized().dot(moved.point(40) - of_truth.point(40)), 0, 1e-10);
        EXPECT_GT((moved.point(40) - of_truth.point(40)).norm(), 1e-8);
        EXPECT_NEAR(moved.cost, cost, 1e-9 * cost);
    }
    target.gauge = CLBA_GAUGE_INNER;
    std::vector<double> centers;
    for (int32_t i = 0; i < 8; ++i)
        for (int k = 0; k < 3; ++k) centers.push_back(of_truth.center(i)[k]);
    target.centers = centers.data();
    const auto distance = [&](const Dense& dense) {
        double sum = 0;
        for (int32_t i = 0; i < 8; ++i) sum += (dense.center(i) - of_truth.center(i)).squaredNorm();
        return sum;
    };
    const double before = distance(Dense(problem, context));
    ASSERT_OK(clba_problem_fix_gauge(problem.get(), &target));
    {
        const Dense moved(problem, context);
        EXPECT_LT(distance(moved), before);
        EXPECT_NEAR(moved.cost, cost, 1e-9 * cost);
    }
    // An image whose centre is not known takes no part.
    const double nan = std::numeric_limits<double>::quiet_NaN();
    std::fill_n(centers.begin() + 6, 3, nan);
    ASSERT_OK(clba_problem_fix_gauge(problem.get(), &target));
    {
        const Dense moved(problem, context);
        const auto known = [&](const Dense& dense) {
            return distance(dense) - (dense.center(2) - of_truth.center(2)).squaredNorm();
        };
        const double least = known(moved);
        std::fill_n(centers.begin() + 6, 3, 1e3);  // would draw all away
        ASSERT_OK(clba_problem_fix_gauge(problem.get(), &target));
        EXPECT_GT(known(Dense(problem, context)), 10 * least);
        std::fill_n(centers.begin() + 6, 3, nan);
        ASSERT_OK(clba_problem_fix_gauge(problem.get(), &target));
        EXPECT_NEAR(known(Dense(problem, context)), least, 1e-6 * least);
    }

    const Data kept = data_of(problem);
    const auto refuses = [&](const std::function<void(clba_gauge_target&)>& change,
                             std::initializer_list<const char*> parts) {
        clba_gauge_target bad = target;
        change(bad);
        EXPECT_TRUE(refused(clba_problem_fix_gauge(problem.get(), &bad), parts));
    };
    refuses([](clba_gauge_target& t) { t.centers = nullptr; }, {"centers"});
    std::vector<double> half_known = centers;
    half_known[3] = nan;
    refuses([&](clba_gauge_target& t) { t.centers = half_known.data(); }, {"centers[1]", "NaN"});
    const std::vector<double> unknown(centers.size(), nan);
    refuses([&](clba_gauge_target& t) { t.centers = unknown.data(); }, {"three images", "0"});
    refuses([](clba_gauge_target& t) { t.gauge = CLBA_GAUGE_PROBLEM; }, {"gauge = problem"});
    refuses([](clba_gauge_target& t) { t.gauge = 9; }, {"gauge = 9"});
    refuses(
        [](clba_gauge_target& t) {
            t.gauge = CLBA_GAUGE_DEFAULT;
            t.baseline = 0;
        },
        {"baseline = 0"});
    refuses(
        [](clba_gauge_target& t) {
            t.gauge = CLBA_GAUGE_DEFAULT;
            t.pose = nullptr;
        },
        {"pose"});
    double line[9] = {0, 0, 0, 1, 1, 1, 2, 2, 2};
    refuses(
        [&](clba_gauge_target& t) {
            t.gauge = CLBA_GAUGE_THREE_POINTS;
            t.xyz = line;
        },
        {"on a line"});
    std::vector<int32_t> flags(8, 0);
    flags[1] = CLBA_CONSTANT_ROTATION;
    ASSERT_OK(clba_problem_set_constant_images(problem.get(), 8, flags.data(), 0));
    refuses([](clba_gauge_target&) {}, {"constant poses"});
    EXPECT_TRUE(data_of(problem) == kept);
}

}  // namespace
}  // namespace clba_test
