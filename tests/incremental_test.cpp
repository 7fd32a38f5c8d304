// SPDX-License-Identifier: Apache-2.0
// Problems that grow and change between solves, and solves of windows, through clba.h.
#include <algorithm>
#include <cmath>
#include <set>

#include "api_rig.hpp"

namespace clba_test {
namespace {

// The rows of a problem from the given ones on, without what they refer to.
struct Part {
    int32_t images, points;
    int64_t observations;
};

void add_rest(const Problem& problem, const Data& data, const Part& from,
              const double* covariances = nullptr) {
    const auto images = static_cast<size_t>(from.images);
    const auto first = static_cast<size_t>(from.observations);
    ASSERT_OK(clba_problem_add_cameras(problem.get(), data.num_cameras() - from.images,
                                       data.models.data() + images, 0,
                                       data.params.data() + 3 * images, 0));
    ASSERT_OK(clba_problem_add_images(problem.get(), data.num_images() - from.images,
                                      data.cameras.data() + images, 0,
                                      data.poses.data() + 7 * images, 0));
    ASSERT_OK(clba_problem_add_points(problem.get(), data.num_points() - from.points,
                                      data.xyz.data() + 3 * from.points, 0));
    ASSERT_OK(clba_problem_add_observations(
        problem.get(), data.num_observations() - from.observations, data.images.data() + first, 0,
        data.points.data() + first, 0, data.xy.data() + 2 * first, 0, covariances, 0));
}

// Observations by their image, so that those of the first images come first.
Data by_image(const Data& data) {
    std::vector<size_t> order(data.images.size());
    for (size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(),
                     [&](size_t a, size_t b) { return data.images[a] < data.images[b]; });
    Data sorted = data;
    for (size_t i = 0; i < order.size(); ++i) {
        sorted.images[i] = data.images[order[i]];
        sorted.points[i] = data.points[order[i]];
        sorted.xy[2 * i] = data.xy[2 * order[i]];
        sorted.xy[2 * i + 1] = data.xy[2 * order[i] + 1];
    }
    return sorted;
}

// Poses whose quaternions keep their bits when they are normalised.
Data normalized(Data data) {
    for (int i = 0; i < 5; ++i) {
        const Data again = data_of(problem_of(data));
        if (again == data) return data;
        data = again;
    }
    ADD_FAILURE() << "normalising goes on for ever";
    return data;
}

// Of the first images, with all points.
Data beginning(const Data& data, int32_t num_images) {
    Data first = data;
    first.models.resize(static_cast<size_t>(num_images));
    first.params.resize(3 * first.models.size());
    first.cameras.resize(first.models.size());
    first.poses.resize(7 * first.models.size());
    const auto end = static_cast<size_t>(
        std::lower_bound(data.images.begin(), data.images.end(), num_images) - data.images.begin());
    first.images.resize(end);
    first.points.resize(end);
    first.xy.resize(2 * end);
    return first;
}

clba_window make_window(const std::vector<int32_t>& images) {
    clba_window window;
    EXPECT_OK(clba_window_init(&window, sizeof window));
    window.num_images = static_cast<int32_t>(images.size());
    window.images = images.data();
    return window;
}

clba_summary solve_window(const Problem& problem, const Context& context,
                          const clba_solver_options& options, clba_window& window) {
    clba_result* result = nullptr;
    EXPECT_OK(clba_problem_solve_window(problem.get(), context.get(), &options, &window, &result));
    const Result owner(result);
    clba_summary summary{};
    summary.struct_size = sizeof summary;
    EXPECT_OK(clba_result_get_summary(result, &summary));
    return summary;
}

class Incremental : public testing::Test {
protected:
    static clba_solver_options options() {
        clba_solver_options options = converged_options();
        options.precision = CLBA_PRECISION_DOUBLE;
        options.linear_solver = CLBA_LINEAR_SOLVER_EXPLICIT_SCHUR;
        return options;
    }
    Context context_ = make_context();
    Data data_ = normalized(by_image(data_of(generate(0, 10, 80).start)));
};

TEST_F(Incremental, AppendedRowsAreThoseOfOneCall) {
    const Problem problem = problem_of(beginning(data_, 6));
    const std::vector<int32_t> constant_images(6, CLBA_CONSTANT_POSITION);
    const std::vector<double> uncertainties(3 * static_cast<size_t>(data_.num_points()), 0.5);
    ASSERT_OK(clba_problem_set_constant_images(problem.get(), 6, constant_images.data(), 0));
    ASSERT_OK(clba_problem_set_point_uncertainties(problem.get(), data_.num_points(),
                                                   uncertainties.data(), 0));
    const Part from{6, data_.num_points(), info_of(problem).num_observations};
    add_rest(problem, data_, from);
    EXPECT_TRUE(data_of(problem) == data_);

    // The first images keep their constant positions, the others are free.
    std::vector<double> before(3 * 10), after(before);
    ASSERT_OK(clba_problem_get_centers(problem.get(), 0, 10, before.data(), 0));
    solve(problem, context_, options());
    ASSERT_OK(clba_problem_get_centers(problem.get(), 0, 10, after.data(), 0));
    for (size_t k = 0; k < before.size(); ++k)
        EXPECT_EQ(std::abs(after[k] - before[k]) < 1e-9, k < 18) << k;
}

TEST_F(Incremental, CovariancesOfTheOthersAreTheIdentity) {
    const Data first = beginning(data_, 9);
    const auto num_new = static_cast<size_t>(data_.num_observations() - first.num_observations());
    const Part from{9, data_.num_points(), first.num_observations()};
    std::vector<double> covariances;
    for (size_t i = 0; i < num_new; ++i) covariances.insert(covariances.end(), {4, 0, 4});
    const auto errors = [](const Problem& problem, int32_t unit) {
        std::vector<double> values(static_cast<size_t>(info_of(problem).num_observations));
        EXPECT_OK(clba_problem_get_reprojection_errors(
            problem.get(), unit, 0, static_cast<int64_t>(values.size()), values.data(), 0));
        return values;
    };
    const auto ratio = [&](const Problem& problem, size_t i) {
        return errors(problem, CLBA_UNIT_PIXELS)[i] / errors(problem, CLBA_UNIT_SIGMAS)[i];
    };
    const auto last = static_cast<size_t>(data_.num_observations()) - 1;
    const Problem problem = problem_of(first);
    add_rest(problem, data_, from, covariances.data());
    EXPECT_NEAR(ratio(problem, 0), 1, 1e-12);
    EXPECT_NEAR(ratio(problem, last), 2, 1e-12);

    const Problem other = problem_of(first);
    const std::vector<double> sigmas(first.images.size(), 3);
    ASSERT_OK(clba_problem_set_sigmas(other.get(), first.num_observations(), sigmas.data(), 0));
    add_rest(other, data_, from);
    EXPECT_NEAR(ratio(other, 0), 3, 1e-12);
    EXPECT_NEAR(ratio(other, last), 1, 1e-12);
}

TEST_F(Incremental, AProblemGrowsBetweenSolves) {
    const Problem grown = problem_of(beginning(data_, 7));
    solve(grown, context_, options());
    const Part from{7, data_.num_points(), info_of(grown).num_observations};
    add_rest(grown, data_, from);
    const Data now = normalized(data_of(grown));
    EXPECT_OK(clba_problem_set_images(grown.get(), 10, now.cameras.data(), 0, now.poses.data(), 0));
    const Problem whole = problem_of(now);
    const clba_summary a = solve(grown, context_, options()), b = solve(whole, context_, options());
    EXPECT_EQ(a.initial_cost, b.initial_cost);
    EXPECT_EQ(a.final_cost, b.final_cost);
    EXPECT_EQ(a.termination, CLBA_CONVERGENCE);
    EXPECT_TRUE(data_of(grown) == data_of(whole));
}

TEST_F(Incremental, RefusedRowsLeaveTheProblem) {
    const Problem problem = problem_of(data_);
    const int32_t bad_camera = 10, bad_image = 10, point = 0, model = 77;
    const double pose[] = {1, 0, 0, 0, 0, 0, 0}, xy[] = {0, 0}, xyz[] = {0, 0, NAN};
    const double covariance[] = {1, 2, 1};
    EXPECT_TRUE(refused(clba_problem_add_cameras(problem.get(), 1, &model, 0, pose, 0), {"77"}));
    EXPECT_TRUE(refused(clba_problem_add_images(problem.get(), 1, &bad_camera, 0, pose, 0),
                        {"camera_indices[0] = 10", "num_cameras = 10"}));
    EXPECT_TRUE(refused(clba_problem_add_points(problem.get(), 1, xyz, 0), {"xyz[0][2]"}));
    EXPECT_TRUE(refused(clba_problem_add_observations(problem.get(), 1, &bad_image, 0, &point, 0,
                                                      xy, 0, nullptr, 0),
                        {"images[0] = 10", "num_images = 10"}));
    EXPECT_TRUE(refused(
        clba_problem_add_observations(problem.get(), 1, &point, 0, &point, 0, xy, 0, covariance, 0),
        {"covariances[0]", "positive definite"}));
    EXPECT_TRUE(refused(clba_problem_add_points(problem.get(), -1, xyz, 0), {"count = -1"}));
    EXPECT_TRUE(data_of(problem) == data_);
}

// What is brought up to date on the device is what a fresh problem has, bit by bit.
TEST_F(Incremental, ConstantsWeightsAndMeasurementsChangeBetweenSolves) {
    const Problem kept = problem_of(data_);
    clba_solver_options short_options = options();
    short_options.max_num_iterations = 2;
    std::vector<int32_t> points(static_cast<size_t>(data_.num_points()), 0), images(10, 0);
    std::vector<double> sigmas(data_.images.size());
    for (size_t i = 0; i < sigmas.size(); ++i) sigmas[i] = 1 + 0.1 * static_cast<double>(i % 7);
    for (size_t p = 0; p < points.size(); p += 3) points[p] = 1;
    images[0] = CLBA_CONSTANT_POSE;
    Data moved = data_;
    const auto expect_as_fresh = [&](auto&& change) {
        const Data now = normalized(data_of(kept));
        const Problem fresh = problem_of(now);
        EXPECT_OK(
            clba_problem_set_images(kept.get(), 10, now.cameras.data(), 0, now.poses.data(), 0));
        change(kept);
        change(fresh);
        solve(kept, context_, short_options);
        solve(fresh, context_, short_options);
        EXPECT_TRUE(data_of(kept) == data_of(fresh));
    };
    const auto set_points = [&](const Problem& p) {
        EXPECT_OK(clba_problem_set_constant_points(p.get(), data_.num_points(), points.data(), 0));
    };
    const auto set_images = [&](const Problem& p) {
        set_points(p);
        EXPECT_OK(clba_problem_set_constant_images(p.get(), 10, images.data(), 0));
    };
    const auto set_sigmas = [&](const Problem& p) {
        EXPECT_OK(clba_problem_set_constant_points(p.get(), 0, nullptr, 0));
        EXPECT_OK(clba_problem_set_constant_images(p.get(), 10, images.data(), 0));
        EXPECT_OK(clba_problem_set_sigmas(p.get(), data_.num_observations(), sigmas.data(), 0));
    };
    const auto set_xy = [&](const Problem& p) {
        EXPECT_OK(clba_problem_set_constant_images(p.get(), 10, images.data(), 0));
        EXPECT_OK(clba_problem_set_observations(p.get(), moved.num_observations(),
                                                moved.images.data(), 0, moved.points.data(), 0,
                                                moved.xy.data(), 0));
    };
    solve(kept, context_, short_options);
    expect_as_fresh(set_points);
    expect_as_fresh(set_images);
    expect_as_fresh(set_sigmas);
    for (double& x : moved.xy) x += 0.5;
    expect_as_fresh(set_xy);
}

// Flags that hold all constant but a window of images and the points that these see.
void hold_the_rest(const Problem& problem, const Data& data, const std::vector<int32_t>& window,
                   const std::set<int32_t>& free_cameras) {
    std::vector<int32_t> images(data.cameras.size(), CLBA_CONSTANT_POSE);
    for (int32_t image : window) images[static_cast<size_t>(image)] = 0;
    std::vector<int32_t> points(data.xyz.size() / 3, 1);
    for (size_t i = 0; i < data.images.size(); ++i)
        if (images[static_cast<size_t>(data.images[i])] == 0)
            points[static_cast<size_t>(data.points[i])] = 0;
    std::vector<int32_t> cameras;
    for (size_t c = 0; c < data.models.size(); ++c)
        cameras.push_back(free_cameras.count(static_cast<int32_t>(c))
                              ? 0
                              : (1 << clba_camera_model_num_params(data.models[c])) - 1);
    EXPECT_OK(clba_problem_set_constant_images(problem.get(), data.num_images(), images.data(), 0));
    EXPECT_OK(clba_problem_set_constant_points(problem.get(), data.num_points(), points.data(), 0));
    EXPECT_OK(
        clba_problem_set_constant_cameras(problem.get(), data.num_cameras(), cameras.data(), 0));
}

double largest_difference(const std::vector<double>& a, const std::vector<double>& b) {
    double largest = 0;
    for (size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
    return largest;
}

TEST_F(Incremental, AWindowIsASolveWithTheRestConstant) {
    const std::vector<int32_t> images{3, 5, 4};
    std::vector<double> sigmas(data_.images.size());
    for (size_t i = 0; i < sigmas.size(); ++i) sigmas[i] = 1 + 0.1 * static_cast<double>(i % 5);
    const Problem windowed = problem_of(data_), whole = problem_of(data_);
    for (const Problem* problem : {&windowed, &whole}) {
        EXPECT_OK(
            clba_problem_set_sigmas(problem->get(), data_.num_observations(), sigmas.data(), 0));
        EXPECT_OK(clba_problem_set_loss(problem->get(), CLBA_LOSS_CAUCHY, 2));
    }
    hold_the_rest(whole, data_, images, {3, 4, 5});
    clba_window window = make_window(images);
    const clba_summary of_window = solve_window(windowed, context_, options(), window);
    EXPECT_EQ(of_window.termination, CLBA_CONVERGENCE);
    EXPECT_LT(of_window.final_cost, 0.5 * of_window.initial_cost);
    EXPECT_LT(window.num_observations, data_.num_observations());
    EXPECT_GT(window.num_constant_images, 0);
    EXPECT_GT(window.num_free_points, 10);
    solve(whole, context_, options());
    const Data a = data_of(windowed), b = data_of(whole);
    EXPECT_LT(largest_difference(a.poses, b.poses), 1e-6);
    EXPECT_LT(largest_difference(a.xyz, b.xyz), 1e-5);
    EXPECT_LT(largest_difference(a.params, b.params), 1e-4);
    EXPECT_NEAR(cost_of(windowed, context_), cost_of(whole, context_), 1e-8);
    EXPECT_GT(largest_difference(a.poses, data_.poses), 1e-4);
    // The rest keeps its bits.
    for (size_t i = 0; i < data_.poses.size(); ++i) {
        const size_t image = i / 7;
        EXPECT_TRUE((image >= 3 && image <= 5) || a.poses[i] == data_.poses[i]) << i;
    }
    EXPECT_EQ(a.images, data_.images);
    EXPECT_EQ(a.xy, data_.xy);
}

TEST_F(Incremental, SharedCamerasStayUnlessAskedFor) {
    Data data = data_;
    data.cameras[2] = 1;                         // images 1 and 2 share it
    const auto params_of = [](const Data& of) {  // of camera 1
        return std::vector<double>(of.params.begin() + 3, of.params.begin() + 6);
    };
    for (const bool refines : {false, true}) {
        for (const std::vector<int32_t>& images : {std::vector<int32_t>{1}, {1, 2}}) {
            const Problem problem = problem_of(data);
            clba_window window = make_window(images);
            window.refine_shared_cameras = refines;
            clba_solver_options once = options();
            once.max_num_iterations = 1;
            solve_window(problem, context_, once, window);
            EXPECT_EQ(params_of(data_of(problem)) != params_of(data), refines || images.size() == 2)
                << refines << images.size();
        }
    }
}

TEST_F(Incremental, NamedPointsAloneAreFree) {
    const Problem problem = problem_of(data_);
    const std::vector<int32_t> images{2, 3}, points{data_.points[0], data_.points.back()};
    clba_window window = make_window(images);
    window.points = points.data();
    window.num_points = 2;
    solve_window(problem, context_, options(), window);
    EXPECT_EQ(window.num_free_points, 2);
    const Data after = data_of(problem);
    for (int32_t p = 0; p < data_.num_points(); ++p) {
        const bool is_same = std::equal(after.xyz.begin() + 3 * p, after.xyz.begin() + 3 * p + 3,
                                        data_.xyz.begin() + 3 * p);
        EXPECT_EQ(is_same, p != points[0] && p != points[1]) << p;
    }
    // Nothing is free in a window of nothing.
    clba_window none = make_window({});
    EXPECT_EQ(solve_window(problem, context_, options(), none).reason, CLBA_REASON_NOTHING_TO_DO);
}

// The lists that windows use follow the problem.
TEST_F(Incremental, WindowsSeeWhatWasAppendedAndRemoved) {
    const std::vector<int32_t> early{1, 2}, late{8, 9};
    clba_solver_options few = options();
    few.max_num_iterations = 3;
    const Problem grown = problem_of(beginning(data_, 7));
    clba_window window = make_window(early);
    solve_window(grown, context_, few, window);
    const Part from{7, data_.num_points(), info_of(grown).num_observations};
    add_rest(grown, data_, from);
    const Problem fresh = problem_of(data_of(grown));
    for (const std::vector<int32_t>& images : {late, early}) {
        clba_window a = make_window(images), b = make_window(images);
        EXPECT_EQ(solve_window(grown, context_, few, a).final_cost,
                  solve_window(fresh, context_, few, b).final_cost);
        EXPECT_EQ(a.num_observations, b.num_observations);
        EXPECT_TRUE(data_of(grown) == data_of(fresh));
    }
    clba_filter_options rules;
    ASSERT_OK(clba_filter_options_init(&rules, sizeof rules));
    rules.remove_points = 1;
    rules.max_reprojection_error = 1;
    for (const Problem* problem : {&grown, &fresh})
        ASSERT_OK(clba_problem_filter(problem->get(), &rules, nullptr));
    const Problem again = problem_of(data_of(grown));
    clba_window a = make_window(late), b = make_window(late);
    EXPECT_EQ(solve_window(grown, context_, few, a).final_cost,
              solve_window(again, context_, few, b).final_cost);
}

TEST_F(Incremental, RefusesWindowsThatAreNone) {
    const Problem problem = problem_of(data_);
    const auto solved = [&](const std::vector<int32_t>& images, auto&& change) {
        clba_window window = make_window(images);
        clba_solver_options given = options();
        change(window, given);
        return clba_problem_solve_window(problem.get(), context_.get(), &given, &window, nullptr);
    };
    const auto nothing = [](auto&, auto&) {};
    EXPECT_TRUE(refused(solved({1, 10}, nothing), {"window.images[1] = 10", "num_images = 10"}));
    EXPECT_TRUE(refused(solved({-1}, nothing), {"window.images[0] = -1"}));
    EXPECT_TRUE(refused(solved({1, 2, 1}, nothing), {"window.images has 1 twice"}));
    EXPECT_TRUE(refused(solved({1}, [](auto& w, auto&) { w.num_points = 1; }),
                        {"window.points is NULL", "num_points = 1"}));
    EXPECT_TRUE(
        refused(solved({1}, [](auto& w, auto&) { w.num_images = -1; }), {"num_images = -1"}));
    EXPECT_TRUE(refused(solved({1}, [](auto&, auto& o) { o.resume_path = "x"; }), {"resume_path"}));
    EXPECT_TRUE(refused(solved({1}, [](auto&, auto& o) { o.eta = 2; }), {"eta = 2"}));
    EXPECT_TRUE(
        refused(clba_problem_solve_window(problem.get(), context_.get(), nullptr, nullptr, nullptr),
                {"window", "NULL"}));
    EXPECT_TRUE(data_of(problem) == data_);
}

}  // namespace
}  // namespace clba_test
