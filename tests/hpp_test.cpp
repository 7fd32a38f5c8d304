// SPDX-License-Identifier: Apache-2.0
// The C++ wrapper: owners, errors, arrays, callbacks. What lies below it is tested through clba.h.
#include <clba/clba.hpp>
// GoogleTest comes after the header under test, which must compile alone.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <thread>

namespace clba_test {

int32_t num_models_elsewhere();

namespace {

using Triple = std::array<double, 3>;

template <class Type>
constexpr bool is_owner =
    !std::is_copy_constructible_v<Type> && !std::is_copy_assignable_v<Type> &&
    std::is_nothrow_move_constructible_v<Type> && std::is_nothrow_move_assignable_v<Type>;
static_assert(is_owner<clba::Context> && is_owner<clba::Problem> && is_owner<clba::Result> &&
              is_owner<clba::Covariance>);

template <class From, class View>
constexpr bool views = std::is_convertible_v<From, View>;
using Input = clba::Rows<const double, 3>;
using Output = clba::Rows<double, 3>;
static_assert(views<const std::vector<double>&, Input> && views<std::vector<Triple>, Input> &&
              views<std::vector<double>&, Output> && views<std::vector<Triple>&, Output> &&
              views<double (&)[6], Output>);
static_assert(!views<const std::vector<double>&, Output> &&
              !views<const std::vector<Triple>&, Output> &&
              !views<const std::vector<float>&, Input> &&
              !views<std::vector<std::array<double, 2>>&, Input>);

// The error that a call throws.
template <class Call>
clba::Error error_of(Call&& call) {
    try {
        call();
    } catch (const clba::Error& error) {
        return error;
    }
    ADD_FAILURE() << "nothing was thrown";
    return {CLBA_OK, ""};
}
template <class Call>
void expect_refused(Call&& call, const std::string& part) {
    const clba::Error error = error_of(call);
    EXPECT_EQ(error.status(), CLBA_ERROR_INVALID_ARGUMENT);
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
}

clba::Scene small_scene() {
    clba::SceneOptions options;
    options.num_images = 8;
    options.observations_per_image = 60;
    return clba::generate(options);
}

TEST(Library, VersionAndNames) {
    EXPECT_NO_THROW(clba::check_version());
    EXPECT_EQ(clba::version(), static_cast<uint32_t>(CLBA_VERSION));
    EXPECT_EQ(num_models_elsewhere(), clba_num_camera_models());
    EXPECT_EQ(clba::camera_model_name(CLBA_CAMERA_OPENCV), "opencv");
    EXPECT_EQ(clba::camera_model_param_names(CLBA_CAMERA_SNAVELY), "f,k1,k2");
    EXPECT_EQ(clba::camera_model_num_params(CLBA_CAMERA_OPENCV), 8);
    EXPECT_EQ(clba::linear_solver_name(CLBA_LINEAR_SOLVER_AUTO), "auto");
    EXPECT_EQ(clba::preconditioner_name(CLBA_PRECONDITIONER_SCHUR_JACOBI), "schur_jacobi");
    EXPECT_EQ(clba::damping_name(CLBA_DAMPING_LEVENBERG), "levenberg");
    EXPECT_EQ(clba::precision_name(CLBA_PRECISION_MIXED), "mixed");
    EXPECT_EQ(clba::jacobian_name(CLBA_JACOBIAN_STORED), "stored");
    EXPECT_EQ(clba::loss_name(CLBA_LOSS_TUKEY), "tukey");
    EXPECT_EQ(clba::scene_name(CLBA_SCENE_STREET), "street");
    EXPECT_EQ(clba::status_string(CLBA_OK), clba_status_string(CLBA_OK));
    expect_refused([] { clba::camera_model_name(99); }, "no camera model 99");
    expect_refused([] { clba::camera_model_num_params(-3); }, "no camera model -3");
    expect_refused([] { clba::loss_name(99); }, "no loss 99");
}

TEST(Library, DevicesAreThoseOfC) {
    int32_t count = 0;
    ASSERT_EQ(clba_num_devices(&count), CLBA_OK);
    const std::vector<clba::DeviceInfo> devices = clba::devices();
    ASSERT_EQ(devices.size(), static_cast<size_t>(count));
    for (size_t i = 0; i < devices.size(); ++i)
        EXPECT_EQ(devices[i].index, static_cast<int32_t>(i));
}

TEST(Library, OptionsHaveTheDefaults) {
    clba_solver_options solver;
    ASSERT_EQ(clba_solver_options_init(&solver, sizeof solver), CLBA_OK);
    const clba::SolverOptions made;
    EXPECT_EQ(made.struct_size, solver.struct_size);
    EXPECT_EQ(made.linear_solver, solver.linear_solver);
    EXPECT_EQ(made.max_seconds, solver.max_seconds);
    EXPECT_EQ(made.on_iteration, nullptr);
    EXPECT_EQ(clba::SceneOptions().num_images, 356);
    EXPECT_EQ(clba::ContextOptions().device_index, -1);
    EXPECT_EQ(clba::EvaluationRequest().precision, CLBA_PRECISION_DOUBLE);
}

TEST(Errors, CarryStatusAndMessage) {
    const clba::Error absent = error_of([] { clba::Problem::read_bal("/nonexistent/scene.txt"); });
    EXPECT_EQ(absent.status(), CLBA_ERROR_FILE);
    EXPECT_NE(std::string(absent.what()).find("/nonexistent/scene.txt"), std::string::npos);
    EXPECT_EQ(error_of([] { clba::Context("no such device"); }).status(), CLBA_ERROR_NO_DEVICE);
    // Each thread has its own last error.
    std::thread([] { expect_refused([] { clba::Problem().set_loss(99); }, "99"); }).join();
}

TEST(Owners, MovingLeavesNothing) {
    clba::Problem a = small_scene().start;
    clba_problem* const handle = a.get();
    clba::Problem b = std::move(a);
    EXPECT_EQ(b.get(), handle);
    EXPECT_FALSE(a);  // NOLINT(bugprone-use-after-move): what is left is the question
    const clba::Problem empty(static_cast<clba_problem*>(nullptr));
    expect_refused([&] { (void)empty.info(); }, "problem is NULL");
    expect_refused([&] { (void)empty.points(); }, "problem is NULL");
    const clba::Result none;
    EXPECT_EQ(none.num_rows(), 0);
    EXPECT_EQ(none.report(), "");
    EXPECT_EQ(none.json(), "{}");
    expect_refused([&] { (void)none.summary(); }, "result is NULL");

    clba::Problem c;
    c = std::move(b);
    EXPECT_EQ(c.get(), handle);
    clba::Problem& same = c;
    c = std::move(same);
    EXPECT_EQ(c.info().num_images, 8);

    clba::Problem adopted(c.detach());
    EXPECT_FALSE(c);
    EXPECT_EQ(adopted.info().num_images, 8);
}

TEST(Owners, ShareOutlivesTheFirst) {
    clba::Problem second(nullptr);
    {
        const clba::Problem first = small_scene().start;
        second = first.share();
        EXPECT_EQ(second.get(), first.get());
    }
    EXPECT_EQ(second.info().num_images, 8);
    clba::Context context;
    const clba::Context other = context.share();
    context = clba::Context(static_cast<clba_context*>(nullptr));
    EXPECT_STREQ(other.device().name,
                 clba::devices()[static_cast<size_t>(other.device().index)].name);
}

TEST(Arrays, EveryLayoutArrives) {
    const clba::Problem from = small_scene().start;
    const clba::Cameras cameras = from.cameras();
    const clba::Images images = from.images();
    const std::vector<Triple> points = from.points();
    const clba::Observations observations = from.observations();
    ASSERT_EQ(cameras.params.size(), 3 * cameras.models.size());

    // As columns of larger structs.
    struct Point {
        int32_t color;
        Triple xyz;
    };
    struct Observation {
        int32_t image;
        std::array<double, 2> xy;
        int32_t point;
    };
    std::vector<Point> wide_points;
    wide_points.reserve(points.size());
    for (const Triple& xyz : points) wide_points.push_back({7, xyz});
    std::vector<Observation> wide;
    wide.reserve(observations.xy.size());
    for (size_t i = 0; i < observations.xy.size(); ++i)
        wide.push_back({observations.images[i], observations.xy[i], observations.points[i]});
    const auto count = static_cast<int64_t>(wide.size());

    clba::Problem to;
    to.set_cameras(cameras.models, cameras.params);
    to.set_images(images.cameras, images.poses);
    to.set_points(
        {wide_points[0].xyz.data(), static_cast<int64_t>(wide_points.size()), sizeof(Point)});
    to.set_observations({&wide[0].image, count, sizeof(Observation)},
                        {&wide[0].point, count, sizeof(Observation)},
                        {wide[0].xy.data(), count, sizeof(Observation)});
    EXPECT_EQ(to.cameras().models, cameras.models);
    EXPECT_EQ(to.cameras().params, cameras.params);
    EXPECT_EQ(to.images().cameras, images.cameras);
    // Quaternions are normalised once more.
    const clba::Images normalised = to.images();
    for (size_t i = 0; i < images.poses.size(); ++i)
        for (size_t k = 0; k < 7; ++k)
            EXPECT_NEAR(normalised.poses[i][k], images.poses[i][k], 1e-12) << i << ' ' << k;
    EXPECT_EQ(to.points(), points);
    EXPECT_EQ(to.observations().images, observations.images);
    EXPECT_EQ(to.observations().points, observations.points);
    EXPECT_EQ(to.observations().xy, observations.xy);

    // Ranges, into flat and strided memory.
    std::array<double, 6> flat{};
    to.get_points(1, flat);
    EXPECT_EQ(flat[0], points[1][0]);
    EXPECT_EQ(flat[5], points[2][2]);
    wide_points.assign(2, Point{7, {}});
    to.get_points(1, {wide_points[0].xyz.data(), 2, sizeof(Point)});
    EXPECT_EQ(wide_points[1].xyz, points[2]);
    EXPECT_EQ(wide_points[1].color, 7);
    std::vector<int32_t> models(2);
    std::vector<double> params(6);
    to.get_cameras(3, models, params);
    EXPECT_EQ(params[0], cameras.params[9]);
    std::vector<Triple> centers(2);
    to.get_centers(3, centers);
    EXPECT_EQ(centers[0], to.centers()[3]);
    for (size_t k = 0; k < 3; ++k) EXPECT_NEAR(centers[1][k], from.centers()[4][k], 1e-9);
    std::vector<int32_t> held(to.points().size());
    held[2] = 1;
    to.set_constant_points(held);
    EXPECT_EQ(to.constant_points(), held);
    held.assign(to.cameras().models.size(), 5);
    to.set_constant_cameras(held);
    EXPECT_EQ(to.constant_cameras(), held);
    held.assign(to.centers().size(), CLBA_CONSTANT_POSITION);
    to.set_constant_images(held);
    EXPECT_EQ(to.constant_images(), held);
}

TEST(Arrays, WrongSizesAreRefused) {
    clba::Problem problem = small_scene().start;
    const std::vector<double> seven(7);
    const std::vector<int32_t> two{0, 1};
    expect_refused([&] { problem.set_points(seven); }, "7 numbers, but a row has 3");
    expect_refused([&] { problem.set_images(two, seven); }, "1 poses, but 2 camera indices");
    expect_refused([&] { problem.set_cameras(two, seven); },
                   "7 numbers for the cameras, but 6 are needed");
    expect_refused([&] { problem.set_cameras(std::vector<int32_t>{99}, seven); },
                   "no camera model 99");
    expect_refused(
        [&] {
            problem.set_observations(two, two, std::vector<double>{1, 2});
        },
        "2 image indices, but 1 observations");
    expect_refused([&] { problem.set_sigmas(seven); }, "7");
    expect_refused([&] { problem.set_camera_uncertainties(seven); }, "but 24 are needed");
    expect_refused([&] { problem.apply_step(seven); }, "7 numbers in the step");
    std::vector<int32_t> models(2);
    std::vector<double> params(5);
    expect_refused([&] { problem.get_cameras(0, models, params); }, "but 6 are needed");
    EXPECT_EQ(problem.info().num_images, 8);
}

TEST(Arrays, NoRowsClear) {
    clba::Problem problem = small_scene().start;
    const auto count = static_cast<size_t>(problem.info().num_points);
    const clba::Context context;
    problem.set_constant_points(std::vector<int32_t>(count, 1));
    problem.set_constant_images(std::vector<int32_t>(8, CLBA_CONSTANT_POSE));
    problem.set_constant_cameras(std::vector<int32_t>(8, 7));
    EXPECT_EQ(problem.solve(context).summary().reason, CLBA_REASON_NOTHING_TO_DO);
    problem.set_constant_points({});
    problem.set_constant_images({});
    problem.set_constant_cameras({});
    problem.set_camera_uncertainties(std::vector<double>(24, 2.0));
    problem.set_camera_uncertainties({});
    EXPECT_EQ(problem.solve(context).summary().termination, CLBA_CONVERGENCE);
}

class Solving : public testing::Test {
protected:
    clba::Scene scene = small_scene();
    clba::Problem& problem = scene.start;
    clba::Context context;
};

TEST_F(Solving, TheCallbackSeesTheRowsOfTheResult) {
    std::vector<double> costs;
    const clba::Result result = problem.solve(context, {}, [&](const clba::Iteration& row) {
        EXPECT_EQ(row.iteration, static_cast<int32_t>(costs.size()));
        costs.push_back(row.cost);
        return clba::Next::go_on;
    });
    const std::vector<clba::Iteration> rows = result.rows();
    ASSERT_EQ(rows.size(), costs.size());
    for (size_t i = 0; i < rows.size(); ++i) EXPECT_EQ(rows[i].cost, costs[i]);
    EXPECT_EQ(result.summary().final_cost, costs.back());
    EXPECT_EQ(result.summary().termination, CLBA_CONVERGENCE);
    EXPECT_EQ(result.report().substr(0, 14), "Solver summary");
    EXPECT_EQ(result.json().front(), '{');
    expect_refused([&] { (void)result.row(1000); }, "1000");
    EXPECT_LT(clba::compare(scene.truth, problem).max_center_distance, 1.0);
}

TEST_F(Solving, TheCallbackStops) {
    const clba::Result result = problem.solve(context, {}, [](const clba::Iteration& row) {
        return row.iteration == 2 ? clba::Next::stop : clba::Next::go_on;
    });
    EXPECT_EQ(result.summary().termination, CLBA_USER_STOP);
    EXPECT_EQ(result.num_rows(), 3);
}

TEST_F(Solving, TheCallbackOfCStays) {
    clba::SolverOptions options;
    int calls = 0;
    options.on_iteration = [](const clba_iteration*, void* user_data) -> int32_t {
        return ++*static_cast<int*>(user_data) == 2;
    };
    options.user_data = &calls;
    EXPECT_EQ(problem.solve(context, options).summary().termination, CLBA_USER_STOP);
    EXPECT_EQ(calls, 2);
}

TEST_F(Solving, WhatTheCallbackThrowsComesOut) {
    struct Unrelated {
        int value;
    };
    const double before = problem.evaluate(context).cost;
    double kept = 0;
    try {
        problem.solve(context, {}, [&](const clba::Iteration& row) {
            kept = row.cost;
            if (row.iteration == 1) throw Unrelated{42};
            return clba::Next::go_on;
        });
        ADD_FAILURE() << "nothing was thrown";
    } catch (const Unrelated& thrown) {
        EXPECT_EQ(thrown.value, 42);
    }
    // The state is that of the last iteration, and the problem goes on working.
    EXPECT_LT(kept, before);
    EXPECT_NEAR(problem.evaluate(context).cost / kept, 1, 1e-10);
    EXPECT_EQ(problem.solve(context).summary().termination, CLBA_CONVERGENCE);
}

TEST_F(Solving, RefusedOptionsThrow) {
    clba::SolverOptions options;
    options.eta = 2;
    expect_refused([&] { problem.solve(context, options); }, "eta");
}

TEST_F(Solving, TheGradientIsTheProduct) {
    const clba::Evaluation evaluation = problem.evaluate(context);
    const clba::ProblemInfo info = problem.info();
    ASSERT_EQ(evaluation.gradient.size(), static_cast<size_t>(info.num_parameters));
    double cost = 0;
    for (const double r : evaluation.residuals) cost += r * r / 2;
    EXPECT_NEAR(cost / evaluation.cost, 1, 1e-12);

    std::vector<double> product;
    problem.multiply(context, CLBA_PRODUCT_JTY, evaluation.residuals, product);
    ASSERT_EQ(product.size(), evaluation.gradient.size());
    double largest = 0;
    for (const double g : evaluation.gradient) largest = std::max(largest, std::abs(g));
    for (size_t i = 0; i < product.size(); ++i)
        EXPECT_NEAR(product[i], evaluation.gradient[i], 1e-10 * largest) << i;
    expect_refused(
        [&] { problem.multiply(context, CLBA_PRODUCT_JX, evaluation.residuals, product); },
        "numbers in x");
    expect_refused([&] { problem.multiply(context, CLBA_PRODUCT_JTY, product, product); }, "x");

    clba::EvaluationRequest request;
    problem.evaluate(context, request);
    EXPECT_EQ(request.cost, evaluation.cost);
    EXPECT_EQ(problem.offsets().poses[0], 0);
    EXPECT_EQ(problem.offsets().intrinsics[0], 6);
}

TEST(Filtering, ReportsWhatWent) {
    clba::Problem problem = small_scene().truth;
    const std::vector<double> errors = problem.reprojection_errors();
    clba::FilterOptions options;
    options.max_reprojection_error = *std::max_element(errors.begin(), errors.end()) * 0.999;
    options.min_num_views = 0;
    options.min_triangulation_angle = 0;
    const clba::Removed removed = problem.filter(options);
    EXPECT_EQ(removed.counts.num_large_error, 1);
    const auto worst = std::max_element(errors.begin(), errors.end()) - errors.begin();
    EXPECT_EQ(removed.observation_rows[static_cast<size_t>(worst)], -1);
    EXPECT_EQ(problem.info().num_observations, static_cast<int64_t>(errors.size()) - 1);

    std::vector<int32_t> flags(errors.size() - 1, 1);
    const clba::Removed rest = problem.remove_observations(flags, true);
    EXPECT_EQ(rest.counts.num_images_unobserved, problem.info().num_images);
    EXPECT_EQ(problem.info().num_points, 0);
}

TEST_F(Solving, AWindowOfAProblemThatGrows) {
    const int32_t num_images = problem.info().num_images;
    const clba::Cameras cameras = problem.cameras();
    const clba::Images images = problem.images();
    const clba::Observations seen = problem.observations();
    // The last image once more, with what it sees.
    problem.add_cameras(std::vector<int32_t>{cameras.models.back()},
                        std::vector<double>(cameras.params.end() - 3, cameras.params.end()));
    problem.add_images(std::vector<int32_t>{num_images},
                       std::vector<std::array<double, 7>>{images.poses.back()});
    problem.add_points(std::vector<Triple>{{0, 0, 0}});
    std::vector<int32_t> points;
    std::vector<std::array<double, 2>> xy;
    for (size_t i = 0; i < seen.images.size(); ++i) {
        if (seen.images[i] != num_images - 1) continue;
        points.push_back(seen.points[i]);
        xy.push_back(seen.xy[i]);
    }
    const std::vector<int32_t> rows(points.size(), num_images);
    problem.add_observations(rows, points, xy);
    EXPECT_EQ(problem.info().num_observations,
              static_cast<int64_t>(seen.images.size() + points.size()));

    clba::Window window({num_images, num_images - 1});
    const clba::Result result = problem.solve_window(context, window);
    EXPECT_EQ(result.summary().termination, CLBA_CONVERGENCE);
    EXPECT_EQ(window.num_free_points, static_cast<int32_t>(points.size()));
    const clba::Images refined = problem.images();
    EXPECT_EQ(refined.poses[0], images.poses[0]);
    EXPECT_NE(refined.poses.back(), images.poses.back());
    clba::Window named({0}, {points[0]});
    problem.solve_window(context, named);
    EXPECT_EQ(named.num_free_points, 1);
    expect_refused([&] { problem.add_observations(rows, points, {}); }, "image indices");
}

TEST_F(Solving, RigsStayRigid) {
    const clba::Images images = problem.images();
    const auto num_images = static_cast<int32_t>(images.poses.size());
    clba::Rigs rigs;
    for (int32_t i = 0; i < num_images; ++i) {
        rigs.frames.push_back(i < 4 ? i / 2 : -1);
        rigs.sensors.push_back(i < 4 ? i % 2 : -1);
    }
    rigs.sensor_poses = {{1, 0, 0, 0, 0, 0, 0}, {1, 0, 0, 0, 0.5, 0, 0}};
    rigs.constant_sensors = {CLBA_CONSTANT_POSE, CLBA_CONSTANT_ROTATION};
    expect_refused([&] { problem.set_rigs(rigs); }, "image 1 is turned by");
    rigs.frame_poses = {images.poses[0], images.poses[2]};
    problem.set_rigs(rigs);
    EXPECT_EQ(problem.info().num_frames, 2);
    EXPECT_EQ(problem.info().num_sensors, 2);
    std::vector<int64_t> offsets(2);
    clba::check(clba_problem_get_sensor_offsets(problem.get(), offsets.data()));
    const std::vector<int64_t> of_images = problem.offsets().poses;
    EXPECT_EQ(of_images[0], of_images[1]);
    EXPECT_EQ(offsets[1], offsets[0] + 6);

    problem.solve(context);
    const clba::Rigs solved = problem.rigs();
    EXPECT_EQ(solved.frames, rigs.frames);
    EXPECT_EQ(solved.constant_sensors, rigs.constant_sensors);
    EXPECT_EQ(solved.constant_frames, (std::vector<int32_t>{0, 0}));
    EXPECT_EQ(solved.sensor_poses[0], rigs.sensor_poses[0]);
    EXPECT_NE(solved.sensor_poses[1], rigs.sensor_poses[1]);
    const clba::Images moved = problem.images();
    for (size_t f = 0; f < 2; ++f) {
        EXPECT_EQ(moved.poses[2 * f], solved.frame_poses[f]);
        for (size_t k = 0; k < 4; ++k)  // sensor 1 is not turned
            EXPECT_EQ(moved.poses[2 * f + 1][k], solved.frame_poses[f][k]);
    }

    // A step of parameters keeps them rigid too, and the gradient is its slope.
    const clba::Evaluation before = problem.evaluate(context);
    std::vector<double> step(before.gradient.size(), 0.0);
    double slope = 0;
    for (size_t k = 0; k < step.size(); ++k) {
        step[k] = 1e-9 * (k % 7 < 4 ? 1 : -1);
        slope += before.gradient[k] * step[k];
    }
    for (int64_t k = 0; k < 6; ++k) slope -= before.gradient[offsets[0] + k] * step[offsets[0] + k];
    problem.apply_step(step);
    const double change = problem.evaluate(context).cost - before.cost;
    EXPECT_NEAR(change, slope, 1e-3 * std::abs(slope) + 1e-12 * before.cost);
    problem.set_rigs({});
    EXPECT_TRUE(problem.rigs().frames.empty());
}

TEST_F(Solving, PriorsArrive) {
    const double bare = problem.evaluate(context).cost;
    const auto added = [&] { return problem.evaluate(context).cost - bare; };
    const std::array<double, 9> unit = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    std::array<double, 36> unit6{};
    for (size_t k = 0; k < 6; ++k) unit6[7 * k] = 1;
    std::vector<Triple> centers = problem.centers();
    centers.resize(2);
    for (Triple& center : centers) center[0] += 2;
    problem.set_position_priors(std::vector<int32_t>{0, 1}, centers,
                                std::vector<std::array<double, 9>>{unit, unit});
    EXPECT_NEAR(added(), 4, 1e-12 * bare);
    problem.set_position_priors({}, {}, {});
    EXPECT_EQ(added(), 0);
    Triple point = problem.points()[3];
    point[2] -= 2;
    problem.set_point_priors(std::vector<int32_t>{3}, point, unit);
    EXPECT_NEAR(added(), 2, 1e-12 * bare);
    problem.set_point_priors({}, {}, {});
    problem.set_pose_priors(std::vector<int32_t>{1}, problem.images().poses[1], unit6);
    EXPECT_NEAR(added(), 0, 1e-12 * bare);
    const std::vector<int32_t> pair = {0, 1};
    problem.set_relative_pose_priors(pair, std::array<double, 7>{1, 0, 0, 0, 0, 0, 0}, unit6);
    EXPECT_GT(added(), 0.01);
    problem.set_relative_pose_priors({}, {}, {});
    std::vector<double> params = problem.cameras().params;
    params[6] += 2;
    problem.set_intrinsics_priors(
        std::vector<int32_t>{2}, std::vector<double>(params.begin() + 6, params.begin() + 9), unit);
    EXPECT_NEAR(added(), 2, 1e-12 * bare);
    expect_refused(
        [&] {
            problem.set_intrinsics_priors(std::vector<int32_t>{2}, std::vector<double>(2), unit);
        },
        "2 numbers");
    expect_refused(
        [&] {
            problem.set_intrinsics_priors(std::vector<int32_t>{8}, std::vector<double>(3), unit);
        },
        "num_cameras");
    expect_refused([&] { problem.set_position_priors(pair, centers, unit); }, "1 covariances");
    EXPECT_EQ(clba::gauge_state_name(CLBA_GAUGE_STATE_FREE), "free");
}

TEST_F(Solving, StepsMovePoints) {
    const clba::ProblemInfo info = problem.info();
    const std::vector<Triple> before = problem.points();
    std::vector<double> step(static_cast<size_t>(info.num_parameters));
    step[static_cast<size_t>(info.num_image_camera_parameters) + 3] = 0.25;
    problem.apply_step(step);
    EXPECT_EQ(problem.points()[1][0], before[1][0] + 0.25);
    EXPECT_EQ(problem.points()[0], before[0]);
}

TEST_F(Solving, AnyFormatAndItsProgress) {
    const std::string name = testing::TempDir() + "hpp_test_model" + std::to_string(::getpid());
    problem.write(name + "/");
    double last = 0;
    const clba::Problem read = clba::Problem::read(name, {}, [&](double fraction) {
        last = fraction;
        return clba::Next::go_on;
    });
    EXPECT_GT(last, 0);
    EXPECT_EQ(read.format(), CLBA_FORMAT_COLMAP_BINARY);
    EXPECT_EQ(read.points(), problem.points());
    EXPECT_EQ(read.image_info().names[0], "image000001");
    EXPECT_EQ(read.camera_info().sizes.size(), read.camera_info().ids.size());
    EXPECT_EQ(read.point_info().colors[0], (std::array<uint8_t, 3>{255, 255, 255}));
    EXPECT_TRUE(read.notices().empty());
    expect_refused([&] { read.check_write("x.txt"); }, "principal points");
    struct Thrown {};
    EXPECT_THROW(clba::Problem::read(name, {}, [](double) -> clba::Next { throw Thrown(); }),
                 Thrown);
    const clba::Error stopped =
        error_of([&] { clba::Problem::read(name, {}, [](double) { return clba::Next::stop; }); });
    EXPECT_EQ(stopped.status(), CLBA_ERROR_CANCELLED);
    std::filesystem::remove_all(name);
}

TEST_F(Solving, CovariancesInAGauge) {
    clba::CovarianceOptions options;
    options.gauge_images[0] = 2;
    options.gauge_images[1] = 5;
    const int32_t points[1] = {4};
    options.points = points;
    options.num_points = 1;
    clba::Covariance covariance = problem.covariance(context, options);
    const clba::CovarianceInfo info = covariance.info();
    EXPECT_EQ(clba::covariance_gauge_name(info.gauge), "first_image_and_baseline");
    EXPECT_EQ(clba::covariance_method_name(info.method), "exact");
    EXPECT_EQ(info.gauge_images[1], 5);
    EXPECT_EQ((covariance.pose(2)), (std::array<double, 36>{}));
    EXPECT_GT(covariance.point(0)[0], 0);
    const std::vector<double> joint = covariance.block(CLBA_BLOCK_POSE_AND_INTRINSICS, 1, 9);
    const std::array<double, 36> pose = covariance.pose(1);
    EXPECT_EQ(joint[9 * 5 + 4], pose[6 * 5 + 4]);
    EXPECT_NEAR(covariance.center(1)[0] + covariance.center(1)[4] + covariance.center(1)[8],
                pose[21] + pose[28] + pose[35], 1e-12 * pose[21]);
    EXPECT_EQ(covariance.standard_errors(CLBA_BLOCK_POINT, 0, 3), std::vector<double>(9));
    expect_refused([&] { covariance.point(1); }, "there are 1");
    expect_refused([&] { covariance.block(CLBA_BLOCK_POINT, 0, 2); }, "stride of 32");
    expect_refused([&] { clba::covariance_gauge_name(9); }, "gauge 9");

    clba::GaugeTarget target;
    const std::array<double, 7> origin{1, 0, 0, 0, 0, 0, 0};
    target.images[0] = 2;
    target.images[1] = 5;
    target.pose = origin.data();
    target.baseline = 3;
    problem.fix_gauge(target);
    EXPECT_EQ(problem.images().poses[2], origin);
    const Triple center = problem.centers()[5];
    EXPECT_NEAR(std::hypot(center[0], center[1], center[2]), 3, 1e-12);
}

TEST_F(Solving, FilesKeepEveryDigit) {
    const std::string name = testing::TempDir() + "hpp_test_" + std::to_string(::getpid());
    const std::string bal = name + ".txt.gz", ply = name + ".ply";
    problem.write_bal(bal);
    problem.write_ply(ply);
    EXPECT_EQ(clba::Problem::read_bal(bal).points(), problem.points());
    std::string first;
    std::ifstream stream(ply);
    EXPECT_TRUE(std::getline(stream, first));
    EXPECT_EQ(first, "ply");
    std::remove(bal.c_str());
    std::remove(ply.c_str());
}

}  // namespace
}  // namespace clba_test
