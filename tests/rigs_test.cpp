// SPDX-License-Identifier: Apache-2.0
// Rigs: the map from parameters to images, steps against dense ones, whole solves.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <string>
#include <vector>

#include "base/error.hpp"
#include "covariance/covariance.hpp"
#include "device_rig.hpp"
#include "linear/linear_solver.hpp"
#include "optimizer/solve.hpp"
#include "problem/fingerprint.hpp"
#include "problem/rigs.hpp"
#include "problem/subproblem.hpp"
#include "reference/gauge.hpp"
#include "reference/priors.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr uint8_t all_of_pose = constant_rotation | constant_position;

Problem rig_scene() {
    return test::rig_scene(4, 60, 71);
}

// They are next to undetermined: the scene is in the middle of the images.
void hold_principal_points(Problem& problem) {
    for (const Camera& camera : problem.cameras)
        problem.constant_cameras.push_back(camera.model == camera_opencv ? 0b1100 : 0);
}

// As if no image were in a rig.
Problem without_rigs(Problem problem) {
    problem.rigs = Rigs();
    return problem;
}

// The F side of the map from tangents of parameters to those of images, with the identity for
// points.
MatrixXd tangent_map(const Problem& problem) {
    const ParameterLayout layout(problem), images = ParameterLayout::of_images(problem);
    MatrixXd map = MatrixXd::Zero(images.num_parameters(problem), layout.num_parameters(problem));
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int32_t row = images.pose_offset[i], column = layout.pose_offset[i];
        if (!layout.is_composed(i)) {
            map.block<6, 6>(row, column).setIdentity();
            continue;
        }
        const int32_t sensor = layout.image_sensor[i];
        const std::array<double, 36> a = frame_tangent(problem.rigs.sensors[sensor]);
        map.block<6, 6>(row, column) =
            Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(a.data());
        map.block<6, 6>(row, layout.sensor_offset(sensor)).setIdentity();
    }
    for (int32_t c = 0; c < problem.num_cameras(); ++c)
        for (int k = 0; k < problem.cameras[c].num_params(); ++k)
            map(images.intrinsics_offset[c] + k, layout.intrinsics_offset[c] + k) = 1;
    map.bottomRightCorner(3 * problem.num_points(), 3 * problem.num_points()).setIdentity();
    return map;
}

// The tangent of the step that takes one pose to another.
Eigen::Matrix<double, 6, 1> tangent(const Pose& from, const Pose& to) {
    const auto& q = from.rotation;
    const auto turn = quaternion_product(to.rotation, {q[0], -q[1], -q[2], -q[3]});
    const auto w = rotation_vector_from_quaternion(turn);
    const auto r = rotation_matrix(turn);
    Eigen::Matrix<double, 6, 1> step;
    for (int k = 0; k < 3; ++k) {
        step[k] = w[k];
        step[3 + k] = to.translation[k];
        for (int m = 0; m < 3; ++m) step[3 + k] -= r[3 * k + m] * from.translation[m];
    }
    return step;
}

// The largest coordinate in which images are not where their frames and sensors put them.
double rigidity_error(const Problem& problem) {
    double largest = 0;
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        if (!problem.rigs.has(i)) continue;
        const Pose &pose = problem.images[i].pose, wanted = composed_pose(problem.rigs, i);
        for (int k = 0; k < 4; ++k)
            largest = std::max(largest, std::abs(pose.rotation[k] - wanted.rotation[k]));
        for (int k = 0; k < 3; ++k)
            largest = std::max(largest, std::abs(pose.translation[k] - wanted.translation[k]));
    }
    return largest;
}

struct Case {
    std::string name;
    Problem problem;
};

std::vector<Case> cases() {
    std::vector<Case> all = {{"free", rig_scene()}};
    Problem constants = rig_scene();
    constants.rigs.constant_sensors[1] = all_of_pose;
    constants.rigs.constant_sensors[2] = constant_rotation;
    constants.rigs.constant_frames[0] = all_of_pose;
    constants.rigs.constant_frames[2] = constant_position;
    constants.constant_images.assign(constants.images.size(), 0);
    constants.constant_images.back() = all_of_pose;
    constants.constant_cameras.assign(constants.cameras.size(), 0);
    constants.constant_cameras[1] = 6;
    constants.constant_points.assign(constants.points.size(), 0);
    constants.constant_points[7] = 1;
    all.push_back({"constants", constants});
    all.push_back(
        {"weights", test::with_loss(test::with_covariances(rig_scene(), 3), LossKind::huber, 0.7)});
    Problem priors = test::with_priors(rig_scene(), 5);
    // Of two sensors of one frame too.
    priors.priors.relative_poses.push_back(priors.priors.relative_poses.front());
    priors.priors.relative_poses.back().first = 3;
    priors.priors.relative_poses.back().second = 5;
    all.push_back({"priors", priors});
    Problem more = test::rig_scene(1, 40, 9);  // every frame but one has one image
    more.rigs.constant_sensors[0] = 0;
    all.push_back({"free reference", more});
    return all;
}

// The damped normal equations of parameters, dense, in double.
struct Dense {
    explicit Dense(const Problem& problem) {
        const ParameterLayout layout(problem);
        const Problem bare = without_rigs(problem);
        const ParameterLayout images = ParameterLayout::of_images(problem);
        const reference::Jacobian blocks = reference::jacobian(bare, images);
        const MatrixXd j = test::dense(bare, images, blocks) * tangent_map(problem);
        std::vector<double> residuals(2 * problem.observations.size());
        reference::residual(problem, residuals.data());
        hessian = j.transpose() * j;
        gradient =
            j.transpose() * Eigen::Map<const VectorXd>(residuals.data(),
                                                       static_cast<Eigen::Index>(residuals.size()));
        if (problem.priors.has_image_side()) {
            reference::ImagePriors(problem, layout)
                .for_each_row(problem.images, problem.cameras, problem.rigs.sensors,
                              [&](double r, int n, const int32_t* scalars, const double* row) {
                                  VectorXd of_row = VectorXd::Zero(hessian.rows());
                                  for (int k = 0; k < n; ++k)
                                      if (scalars[k] >= 0) of_row[scalars[k]] += row[k];
                                  hessian += of_row * of_row.transpose();
                                  gradient += r * of_row;
                              });
            for (const PointPrior& prior : problem.priors.points) {
                const Eigen::Index at = layout.num_f + 3 * prior.point;
                const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> whitening(
                    prior.whitening.data());
                Eigen::Vector3d offset;
                for (int k = 0; k < 3; ++k)
                    offset[k] = problem.points[prior.point][k] - prior.position[k];
                hessian.block<3, 3>(at, at) += whitening.transpose() * whitening;
                gradient.segment<3>(at) += whitening.transpose() * (whitening * offset);
            }
        }
        is_free.assign(static_cast<size_t>(hessian.rows()), 1);
        for (int32_t k = 0; k < layout.num_f; ++k) is_free[k] = layout.scale[k] > 0;
        for (int32_t p = 0; p < problem.num_points(); ++p)
            for (int k = 0; k < 3; ++k)
                is_free[layout.num_f + 3 * p + k] = point_scale(problem, p)[k] > 0;
        for (Eigen::Index k = 0; k < hessian.rows(); ++k) {
            if (is_free[k]) continue;
            hessian.row(k).setZero();
            hessian.col(k).setZero();
            gradient[k] = 0;
        }
    }

    VectorXd step(double lambda) const {
        MatrixXd damped = hessian;
        for (Eigen::Index k = 0; k < damped.rows(); ++k)
            damped(k, k) = is_free[k] ? damped(k, k) + lambda * std::max(damped(k, k), 1e-6) : 1;
        // Scaled to a unit diagonal.
        const VectorXd scale = damped.diagonal().cwiseSqrt().cwiseInverse();
        const MatrixXd scaled = scale.asDiagonal() * damped * scale.asDiagonal();
        return scale.asDiagonal() * scaled.llt().solve(-(scale.asDiagonal() * gradient));
    }

    MatrixXd hessian;
    VectorXd gradient;
    std::vector<char> is_free;
};

MinimizerOptions minimizer_options(LinearSolverKind kind = LinearSolverKind::pcg_schur) {
    MinimizerOptions options;
    options.linear_solver.kind = kind;
    options.linear_solver.preconditioner = kind == LinearSolverKind::pcg_hessian
                                               ? Preconditioner::block_jacobi
                                               : Preconditioner::schur_jacobi;
    options.function_tolerance = 1e-12;
    options.gradient_tolerance = 1e-12;
    return options;
}

Summary solve_in(Problem& problem, const MinimizerOptions& options,
                 Precision precision = Precision::double_precision) {
    std::unique_ptr<DeviceProblem> device;
    return solve(problem, test::test_context(), options, precision, device);
}

TEST(RigTangents, AreDerivativesOfComposedPoses) {
    const Problem problem = rig_scene();
    const ParameterLayout layout(problem), images = ParameterLayout::of_images(problem);
    const MatrixXd map = tangent_map(problem);
    constexpr double step = 1e-3;
    for (Eigen::Index k = 0; k < layout.num_f; ++k) {
        if (!(layout.scale[k] > 0)) continue;
        const auto moved = [&](double h) {
            std::vector<double> delta(static_cast<size_t>(layout.num_parameters(problem)), 0.0);
            delta[k] = h;
            Problem at = problem;
            apply_step(layout, delta.data(), at);
            VectorXd tangents(6 * problem.num_images());
            for (int32_t i = 0; i < problem.num_images(); ++i)
                tangents.segment<6>(6 * i) = tangent(problem.images[i].pose, at.images[i].pose);
            return tangents;
        };
        const VectorXd derivative = test::central_difference(moved, step);
        for (int32_t i = 0; i < problem.num_images(); ++i)
            EXPECT_LE((derivative.segment<6>(6 * i) - map.block(images.pose_offset[i], k, 6, 1))
                          .cwiseAbs()
                          .maxCoeff(),
                      1e-10)
                << "scalar " << k << ", image " << i;
    }
}

TEST(RigTangents, ImagesAloneAtTheOriginAreNotComposed) {
    const Problem problem = rig_scene();
    const ParameterLayout layout(problem);
    EXPECT_EQ(layout.composed.size(), 13u);  // 4 frames of 3, and one of sensor 1 alone
    EXPECT_TRUE(layout.is_composed(12));
    EXPECT_FALSE(layout.is_composed(13));
    EXPECT_FALSE(layout.is_composed(14));
    // 5 frames, 3 images, 3 sensors, and the parameters of cameras.
    EXPECT_EQ(layout.num_f, 6 * 11 + 4 * 8 + 3);
}

// Gradient, damping and the product with J^T J.
void expect_dense_system(const Problem& problem) {
    const Dense dense(problem);
    DeviceProblem device(test::test_context(), problem, Precision::double_precision);
    device.upload_state(problem);
    Evaluator evaluator(device, problem);
    NormalEquations equations(device, DampingOptions(), JacobianForm::recomputed, problem.loss);
    equations.keep_wide_gradient();
    evaluator.linearize(equations);
    const auto n = static_cast<size_t>(device.layout().num_parameters(problem));
    const auto download = [&](const Vector& vector) {
        std::vector<double> values(n);
        device.download(vector, values.data());
        return VectorXd(Eigen::Map<const VectorXd>(values.data(), dense.gradient.size()));
    };
    Vector full = device.make_vector("vector");
    equations.get_gradient(full);
    EXPECT_LE((download(full) - dense.gradient).norm(), 1e-12 * dense.gradient.norm());
    equations.get_damping(full);
    const VectorXd damping = download(full);
    for (Eigen::Index k = 0; k < damping.size(); ++k) {
        const double wanted = dense.is_free[k] ? std::max(dense.hessian(k, k), 1e-6) : 0;
        EXPECT_NEAR(damping[k], wanted, 1e-12 * wanted) << k;
    }
    // Undamped products.
    const std::vector<double> x = test::random_vector(static_cast<int64_t>(n), 6);
    device.upload(x.data(), full);
    device.vectors().mask_constants(device.scale_f, full.f);
    VectorXd free_x = Eigen::Map<const VectorXd>(x.data(), dense.gradient.size());
    for (Eigen::Index k = 0; k < free_x.size(); ++k)
        if (!dense.is_free[k]) free_x[k] = 0;
    if (!device.chunks()[0].point_scale && !device.priors()) {
        equations.jacobian.multiply(full);
        Vector product = device.make_vector("product");
        equations.jacobian.add_transposed(product);
        device.vectors().mask_constants(device.scale_f, product.f);
        const VectorXd wanted = dense.hessian * free_x;
        EXPECT_LE((download(product) - wanted).norm(), 1e-12 * wanted.norm());
    }
}

TEST(RigSystems, EqualDenseOnes) {
    for (const Case& test_case : cases()) {
        SCOPED_TRACE(test_case.name);
        expect_dense_system(test_case.problem);
    }
    // As on GPUs; one model has fewer kernels to build.
    Problem problem = rig_scene();
    for (Camera& camera : problem.cameras) camera = problem.cameras[0];
    const std::shared_ptr<Context> context = test::test_context();
    test::set_shape(*context, test::group_shape(7, 3, 16, 64));
    expect_dense_system(problem);
    test::set_shape(*context, test::device_shape());
}

TEST(RigSystems, StepsEqualDenseOnes) {
    constexpr double lambda = 1e-2;
    struct Method {
        const char* name;
        LinearSolverKind kind;
        Preconditioner preconditioner;
        int min_iterations;
    };
    constexpr Method methods[] = {
        {"pcg_schur", LinearSolverKind::pcg_schur, Preconditioner::schur_jacobi, 300},
        {"pcg_schur, block_jacobi", LinearSolverKind::pcg_schur, Preconditioner::block_jacobi, 300},
        {"pcg_hessian", LinearSolverKind::pcg_hessian, Preconditioner::block_jacobi, 800},
        {"explicit_schur", LinearSolverKind::explicit_schur, Preconditioner::none, 0},
        {"direct_schur", LinearSolverKind::direct_schur, Preconditioner::none, 0}};
    for (const Case& test_case : cases()) {
        const Problem& problem = test_case.problem;
        const VectorXd wanted = Dense(problem).step(lambda);
        DeviceProblem device(test::test_context(), problem, Precision::double_precision);
        device.upload_state(problem);
        Evaluator evaluator(device, problem);
        NormalEquations equations(device, DampingOptions(), JacobianForm::recomputed, problem.loss);
        evaluator.linearize(equations);
        for (const Method& method : methods) {
            SCOPED_TRACE(test_case.name + ", " + method.name);
            LinearSolverOptions options;
            options.kind = method.kind;
            options.preconditioner = method.preconditioner;
            options.min_iterations = method.min_iterations;
            options.max_iterations = 3000;
            options.eta = std::numeric_limits<double>::epsilon();
            const auto solver = make_linear_solver(options, problem, equations);
            const LinearSolution solution = solver->solve(lambda);
            ASSERT_TRUE(solution.is_usable);
            EXPECT_EQ(solution.num_indefinite_blocks, 0);
            Vector step = device.make_vector("step");
            solver->get_step(step);
            std::vector<double> values(static_cast<size_t>(wanted.size()));
            device.download(step, values.data());
            const Eigen::Map<const VectorXd> found(values.data(), wanted.size());
            EXPECT_LE((found - wanted).norm(), 1e-9 * wanted.norm());
            EXPECT_NEAR(solution.step_norm, wanted.norm(), 1e-8 * wanted.norm());

            // The trial state is the one that the step leads to, and rigid.
            Problem moved = problem, applied = problem;
            apply_step(device.layout(), values.data(), applied);
            device.state.swap(device.trial);
            device.download_state(moved);
            device.state.swap(device.trial);
            EXPECT_EQ(rigidity_error(moved), 0);
            for (int32_t i = 0; i < problem.num_images(); ++i)
                EXPECT_LE(tangent(applied.images[i].pose, moved.images[i].pose).norm(), 1e-12);
        }
    }
}

// Each solver, precision and shape of a constant: rigid images, constants as they were, and the
// cost that noise of half a pixel leaves.
TEST(RigSolves, EndRigidAtTheCostOfTheNoise) {
    struct Run {
        LinearSolverKind kind;
        Precision precision;
    };
    const std::vector<Run> runs = {{LinearSolverKind::pcg_schur, Precision::double_precision},
                                   {LinearSolverKind::pcg_hessian, Precision::double_precision},
                                   {LinearSolverKind::explicit_schur, Precision::double_precision},
                                   {LinearSolverKind::direct_schur, Precision::double_precision},
                                   {LinearSolverKind::automatic, Precision::mixed},
                                   {LinearSolverKind::pcg_schur, Precision::mixed},
                                   {LinearSolverKind::explicit_schur, Precision::mixed},
                                   {LinearSolverKind::pcg_schur, Precision::single},
                                   {LinearSolverKind::explicit_schur, Precision::single}};
    double best = 0;
    for (const Run& run : runs) {
        SCOPED_TRACE(testing::Message() << "solver " << static_cast<int>(run.kind) << ", precision "
                                        << static_cast<int>(run.precision));
        Problem problem = test::rig_scene(6, 120, 8);
        hold_principal_points(problem);
        const Problem start = problem;
        MinimizerOptions options = minimizer_options(run.kind);
        if (run.precision != Precision::double_precision) options.function_tolerance = 1e-7;
        const Summary summary = solve_in(problem, options, run.precision);
        EXPECT_EQ(summary.termination, Termination::convergence) << summary.message;
        EXPECT_EQ(summary.num_invalid_steps, 0);
        EXPECT_LE(rigidity_error(problem), 1e-14);
        EXPECT_EQ(problem.rigs.sensors[0].rotation, start.rigs.sensors[0].rotation);
        EXPECT_EQ(problem.rigs.sensors[0].translation, start.rigs.sensors[0].translation);
        EXPECT_NE(problem.rigs.sensors[1].translation, start.rigs.sensors[1].translation);
        const double freedom =
            2.0 * static_cast<double>(problem.num_observations()) -
            static_cast<double>(ParameterLayout(problem).num_parameters(problem)) + 6 + 2 * 5 +
            7;  // a sensor, principal points, and the similarity
        // 2 cost / sigma^2 has the mean `freedom` and the variance 2 freedom.
        EXPECT_NEAR(2 * summary.final_cost / 0.25, freedom, 5 * std::sqrt(2 * freedom));
        if (best == 0) best = summary.final_cost;
        const double share = run.precision == Precision::single ? 1e-4 : 1e-6;
        EXPECT_NEAR(summary.final_cost, best, share * best);
        EXPECT_NEAR(summary.reference_final_cost, summary.final_cost, share * best);
    }
}

TEST(RigSolves, ConstantsKeepTheirBits) {
    for (const Precision precision : {Precision::double_precision, Precision::single}) {
        Problem problem = cases()[1].problem;
        const Problem start = problem;
        const Summary summary = solve_in(problem, minimizer_options(), precision);
        EXPECT_LT(summary.final_cost, 0.1 * summary.initial_cost);
        EXPECT_EQ(problem.rigs.sensors[1].rotation, start.rigs.sensors[1].rotation);
        EXPECT_EQ(problem.rigs.sensors[1].translation, start.rigs.sensors[1].translation);
        EXPECT_EQ(problem.rigs.sensors[2].rotation, start.rigs.sensors[2].rotation);
        EXPECT_NE(problem.rigs.sensors[2].translation, start.rigs.sensors[2].translation);
        EXPECT_EQ(problem.rigs.frames[0].rotation, start.rigs.frames[0].rotation);
        EXPECT_EQ(problem.rigs.frames[0].translation, start.rigs.frames[0].translation);
        EXPECT_EQ(problem.images[1].pose.translation, start.images[1].pose.translation);
        EXPECT_NE(problem.rigs.frames[1].translation, start.rigs.frames[1].translation);
        EXPECT_LE(rigidity_error(problem), 1e-14);
    }
}

// A rig of one sensor at its origin is no rig.
TEST(RigSolves, OneSensorChangesNoBit) {
    for (const LinearSolverKind kind :
         {LinearSolverKind::pcg_schur, LinearSolverKind::explicit_schur}) {
        Problem bare = test::mixed_scene(6, 60, 12);
        bare.constant_images.assign(bare.images.size(), 0);
        Problem rigged = bare;
        bare.constant_images[1] = constant_position;
        Rigs& rigs = rigged.rigs;
        for (int32_t i = 0; i < bare.num_images(); ++i) {
            rigs.image_frame.push_back(i);
            rigs.image_sensor.push_back(rigged.images[i].camera);
            rigs.frames.push_back(rigged.images[i].pose);
        }
        rigs.sensors.resize(rigged.cameras.size());
        rigs.constant_sensors.assign(rigged.cameras.size(), all_of_pose);
        rigs.constant_frames = bare.constant_images;
        rigged.validate();
        const Summary a = solve_in(bare, minimizer_options(kind), Precision::mixed);
        const Summary b = solve_in(rigged, minimizer_options(kind), Precision::mixed);
        EXPECT_EQ(a.final_cost, b.final_cost);
        EXPECT_EQ(a.peak_device_bytes, b.peak_device_bytes);
        EXPECT_EQ(a.rows.size(), b.rows.size());
        for (int32_t i = 0; i < bare.num_images(); ++i) {
            EXPECT_EQ(bare.images[i].pose.rotation, rigged.images[i].pose.rotation);
            EXPECT_EQ(bare.images[i].pose.translation, rigged.images[i].pose.translation);
            EXPECT_EQ(rigs.frames[i].rotation, rigged.images[i].pose.rotation);
            EXPECT_EQ(rigs.frames[i].translation, rigged.images[i].pose.translation);
        }
    }
}

TEST(RigSolves, AreEqualInEveryBitAndWhereResumed) {
    const std::string path = testing::TempDir() + "clba_rigs_test.checkpoint";
    for (const Precision precision : {Precision::mixed, Precision::single}) {
        MinimizerOptions options = minimizer_options();
        options.function_tolerance = 1e-7;
        Problem whole = rig_scene(), again = rig_scene(), resumed = rig_scene();
        const Summary of_whole = solve_in(whole, options, precision);
        const Summary of_again = solve_in(again, options, precision);
        EXPECT_EQ(of_whole.final_cost, of_again.final_cost);
        MinimizerOptions part = options;
        part.max_iterations = 2;
        part.checkpoint_path = path;
        solve_in(resumed, part, precision);
        EXPECT_NE(resumed.images[4].pose.rotation, whole.images[4].pose.rotation);
        Problem other = rig_scene();
        options.resume_path = path;
        const Summary of_resumed = solve_in(other, options, precision);
        EXPECT_EQ(of_resumed.final_cost, of_whole.final_cost);
        for (size_t i = 0; i < whole.images.size(); ++i) {
            EXPECT_EQ(other.images[i].pose.rotation, whole.images[i].pose.rotation);
            EXPECT_EQ(other.images[i].pose.translation, whole.images[i].pose.translation);
            EXPECT_EQ(again.images[i].pose.translation, whole.images[i].pose.translation);
        }
    }
    std::remove(path.c_str());
    Problem held = rig_scene();
    held.rigs.constant_frames[1] = all_of_pose;
    EXPECT_NE(fingerprint(held), fingerprint(rig_scene()));
    EXPECT_NE(fingerprint(without_rigs(rig_scene())), fingerprint(rig_scene()));
}

// A window is a solve with all else constant. Frames enter it as a whole.
TEST(RigSolves, WindowsEqualSolvesOfTheRest) {
    for (const bool refines_sensors : {false, true}) {
        const Problem start = rig_scene();
        const ObservationIndex index(start);
        Window window;
        window.images = {4, 8, 14};  // of frames 1 and 2, and of no rig
        window.refine_shared_cameras = refines_sensors;
        Subproblem part = extract(start, index, window);
        part.problem.validate();
        EXPECT_EQ(part.num_constant_images + 7, static_cast<int>(part.rows.images.size()));
        MinimizerOptions options = minimizer_options(LinearSolverKind::explicit_schur);
        const Summary of_part = solve_in(part.problem, options);
        Problem found = start;
        write_state_back(part, found);
        EXPECT_LE(rigidity_error(found), 1e-14);

        Problem held = start;
        held.rigs.constant_frames.assign(held.rigs.frames.size(), all_of_pose);
        held.rigs.constant_frames[1] = held.rigs.constant_frames[2] = 0;
        if (!refines_sensors) held.rigs.constant_sensors.assign(3, all_of_pose);
        held.constant_images.assign(held.images.size(), 0);
        held.constant_images[15] = all_of_pose;
        held.constant_cameras.assign(held.cameras.size(), refines_sensors ? 0 : ~uint32_t{0});
        held.constant_cameras[3] = ~uint32_t{0};
        held.constant_cameras[4] = 0;
        // The window's seven images see all points, so that nothing is left out.
        EXPECT_EQ(part.problem.num_observations(), start.num_observations());
        const Summary of_whole = solve_in(held, options);
        EXPECT_NEAR(of_part.final_cost, of_whole.final_cost, 1e-9 * of_whole.final_cost);
        for (int32_t i = 0; i < start.num_images(); ++i)
            EXPECT_LE(tangent(held.images[i].pose, found.images[i].pose).norm(), 1e-5) << i;
        EXPECT_EQ(found.rigs.sensors[1].translation == start.rigs.sensors[1].translation,
                  !refines_sensors);
        EXPECT_EQ(found.rigs.frames[0].translation, start.rigs.frames[0].translation);
    }
}

// The block of H^-1 with functionals (columns) held at 0, for parameters that are free.
MatrixXd constrained_inverse(const Dense& dense, const MatrixXd& held) {
    const Eigen::Index n = dense.hessian.rows(), m = held.cols();
    VectorXd scale(n);
    for (Eigen::Index k = 0; k < n; ++k)
        scale[k] = dense.is_free[k] ? 1 / std::sqrt(dense.hessian(k, k)) : 0;
    MatrixXd system = MatrixXd::Zero(n + m, n + m);
    system.topLeftCorner(n, n) = scale.asDiagonal() * dense.hessian * scale.asDiagonal();
    for (Eigen::Index k = 0; k < n; ++k)
        if (!dense.is_free[k]) system(k, k) = 1;
    system.topRightCorner(n, m) = scale.asDiagonal() * held;
    for (Eigen::Index k = 0; k < m; ++k) system.col(n + k).normalize();
    system.bottomLeftCorner(m, n) = system.topRightCorner(n, m).transpose();
    return scale.asDiagonal() * system.inverse().topLeftCorner(n, n) * scale.asDiagonal();
}

TEST(RigCovariances, EqualDenseOnes) {
    Problem problem = test::rig_scene(4, 60, 71);
    hold_principal_points(problem);
    solve_in(problem, minimizer_options(LinearSolverKind::explicit_schur));
    const auto position_of = [](const Problem& p, int32_t image) {
        return Eigen::Map<const Eigen::Vector3d>(camera_center(p.images[image].pose).data()).eval();
    };
    struct Way {
        const char* name;
        Gauge gauge;
        bool constant_sensor, constant_frame;
        int num_freedoms;
    };
    for (const Way& way : {Way{"baseline", Gauge::first_image_and_baseline, false, false, 7},
                           Way{"rig's length", Gauge::first_image_and_baseline, true, false, 6},
                           Way{"constants", Gauge::problem, true, true, 0}}) {
        SCOPED_TRACE(way.name);
        Problem held = problem;
        if (way.constant_sensor) held.rigs.constant_sensors[1] = all_of_pose;
        if (way.constant_frame) held.rigs.constant_frames[2] = all_of_pose;
        DeviceProblem device(test::test_context(), held, Precision::double_precision);
        device.upload_state(held);
        CovarianceOptions options;
        options.all_points = true;
        options.gauge.gauge = way.gauge;
        if (way.gauge != Gauge::problem) options.gauge.images = {4, 11};
        options.method = CovarianceMethod::exact;
        const Covariance covariance = compute_covariance(held, device, options);
        EXPECT_EQ(covariance.num_freedoms, way.num_freedoms);

        const MatrixXd map = tangent_map(held);
        const ParameterLayout images = ParameterLayout::of_images(held), layout(held);
        MatrixXd functionals(map.cols(), way.num_freedoms);
        for (int k = 0; k < std::min(way.num_freedoms, 6); ++k)
            functionals.col(k) = map.row(images.pose_offset[4] + k).transpose();
        if (way.num_freedoms == 7) {
            const Eigen::Vector3d baseline = position_of(held, 11) - position_of(held, 4);
            const auto r = rotation_matrix(held.images[11].pose.rotation);
            const Eigen::Vector3d along =
                Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r.data()) * baseline;
            functionals.col(6) = map.middleRows(images.pose_offset[11] + 3, 3).transpose() * along;
        }
        const MatrixXd wanted =
            map * constrained_inverse(Dense(held), functionals) * map.transpose();
        const auto expect_near = [](const MatrixXd& found, const MatrixXd& expected, int row) {
            EXPECT_LE((found - expected).norm(), 1e-6 * expected.norm() + 1e-18) << row;
        };
        using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
        for (int32_t i = 0; i < held.num_images(); ++i) {
            const int size = covariance.image_size[i];
            std::vector<Eigen::Index> rows;
            for (int k = 0; k < size; ++k)
                rows.push_back(k < 6 ? images.pose_offset[i] + k
                                     : images.intrinsics_offset[held.images[i].camera] + k - 6);
            MatrixXd expected(size, size);
            for (int r = 0; r < size; ++r)
                for (int c = 0; c < size; ++c) expected(r, c) = wanted(rows[r], rows[c]);
            if (i == 4 && way.num_freedoms > 0) {
                expected.topRows(6).setZero();
                expected.leftCols(6).setZero();
            }
            expect_near(Eigen::Map<const RowMajor>(
                            covariance.images.data() + covariance.image_begin[i], size, size),
                        expected, i);
        }
        for (int32_t p = 0; p < held.num_points(); ++p)
            expect_near(Eigen::Map<const RowMajor>(covariance.point_values.data() + 9 * p, 3, 3),
                        wanted.block(images.num_f + 3 * p, images.num_f + 3 * p, 3, 3), p);

        if (way.num_freedoms != 6) continue;
        options.method = CovarianceMethod::sampled;
        options.num_samples = 200;
        const Covariance sampled = compute_covariance(held, device, options);
        for (size_t k = 0; k < covariance.images.size(); ++k)
            EXPECT_EQ(sampled.images[k] == 0, covariance.images[k] == 0) << k;
        for (int32_t i = 0; i < held.num_images(); ++i) {
            for (int k = 0; k < 6; ++k) {
                const int64_t at =
                    covariance.image_begin[i] + k * (covariance.image_size[i] + int64_t{1});
                // Five standard errors of a variance.
                EXPECT_NEAR(sampled.images[at], covariance.images[at],
                            5 * std::sqrt(2.0 / 200) * covariance.images[at]);
            }
        }
    }
}

TEST(RigGauges, AreHeldByFramesAndByBaselines) {
    const auto freedoms = [](const Problem& problem) {
        return reference::gauge_of(problem, ParameterLayout(problem)).num_freedoms;
    };
    Problem problem = rig_scene();
    EXPECT_EQ(freedoms(problem), 7);
    problem.rigs.constant_sensors[1] = all_of_pose;  // which fixes the scale
    EXPECT_EQ(freedoms(problem), 6);
    problem.rigs.constant_frames[3] = all_of_pose;
    EXPECT_EQ(freedoms(problem), 0);
    problem.rigs.constant_sensors[1] = constant_rotation;
    EXPECT_EQ(freedoms(problem), 1);
    EXPECT_EQ(freedoms(test::with_priors(rig_scene(), 5)), 0);
}

TEST(RigChecks, NameWhatIsWrong) {
    const auto message = [](auto&& change) {
        Problem problem = rig_scene();
        change(problem);
        try {
            problem.validate();
        } catch (const Error& error) {
            return std::string(error.what());
        }
        return std::string();
    };
    const auto expect = [&](const char* part, auto&& change) {
        EXPECT_NE(message(change).find(part), std::string::npos) << message(change);
    };
    EXPECT_EQ(message([](Problem&) {}), "");
    expect("rigs.frames[2] = 6", [](Problem& p) { p.rigs.image_frame[2] = 6; });
    expect("rigs.sensors[2] = 3", [](Problem& p) { p.rigs.image_sensor[2] = 3; });
    expect("rigs.sensors[2] = -1", [](Problem& p) { p.rigs.image_sensor[2] = -1; });
    expect("frame 4 has no image",
           [](Problem& p) { p.rigs.image_frame[12] = p.rigs.image_sensor[12] = -1; });
    expect("image 1 is constant", [](Problem& p) {
        p.constant_images.assign(p.images.size(), 0);
        p.constant_images[1] = 1;
    });
    expect("image 0 has an uncertainty of 2", [](Problem& p) {
        p.image_uncertainties.assign(p.images.size(), {1, 1, 2, 1, 1, 1});
    });
    expect("sensor_poses[1]", [](Problem& p) { p.rigs.sensors[1].rotation[0] += 1; });
    expect("constant_frames has 5 rows", [](Problem& p) { p.rigs.constant_frames.pop_back(); });

    Problem apart = rig_scene();
    std::vector<Pose> frames = frames_from_images(apart.rigs, apart.images);
    for (size_t f = 0; f < frames.size(); ++f)
        EXPECT_LE(tangent(apart.rigs.frames[f], frames[f]).norm(), 1e-12);
    apart.images[5].pose.translation[1] += 1e-3;
    try {
        frames_from_images(apart.rigs, apart.images);
        ADD_FAILURE();
    } catch (const Error& error) {
        EXPECT_NE(std::string(error.what()).find("image 5 is turned by"), std::string::npos)
            << error.what();
    }
}

}  // namespace
}  // namespace clba
