// SPDX-License-Identifier: Apache-2.0
#pragma once
// What tests of the shared library share. They see clba.h and nothing else of the project.
#include <clba/clba.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <string>
#include <vector>

#define ASSERT_OK(call) ASSERT_EQ(call, CLBA_OK) << clba_last_error()
#define EXPECT_OK(call) EXPECT_EQ(call, CLBA_OK) << clba_last_error()

namespace clba_test {

struct Release {
    void operator()(clba_context* context) const { clba_context_release(context); }
    void operator()(clba_problem* problem) const { clba_problem_release(problem); }
    void operator()(clba_result* result) const { clba_result_release(result); }
};
using Context = std::unique_ptr<clba_context, Release>;
using Problem = std::unique_ptr<clba_problem, Release>;
using Result = std::unique_ptr<clba_result, Release>;

// Whether a call ended with this status and a message that holds all parts.
inline testing::AssertionResult refused(clba_status got, clba_status expected,
                                        std::initializer_list<const char*> parts) {
    const std::string message = clba_last_error();
    if (got != expected)
        return testing::AssertionFailure() << clba_status_string(got) << " and not "
                                           << clba_status_string(expected) << ": " << message;
    for (const char* part : parts)
        if (message.find(part) == std::string::npos)
            return testing::AssertionFailure() << "no \"" << part << "\" in: " << message;
    return testing::AssertionSuccess();
}
inline testing::AssertionResult refused(clba_status got, std::initializer_list<const char*> parts) {
    return refused(got, CLBA_ERROR_INVALID_ARGUMENT, parts);
}

inline Context make_context() {
    clba_context* context = nullptr;
    EXPECT_OK(clba_context_create(nullptr, &context));
    return Context(context);
}

inline clba_problem_info info_of(const Problem& problem) {
    clba_problem_info info;
    info.struct_size = sizeof info;
    EXPECT_OK(clba_problem_get_info(problem.get(), &info));
    return info;
}

// A problem's arrays, one number a parameter; camera rows without gaps.
struct Data {
    std::vector<int32_t> models, cameras, images, points;
    std::vector<double> params, poses, xyz, xy;

    int32_t num_cameras() const { return static_cast<int32_t>(models.size()); }
    int32_t num_images() const { return static_cast<int32_t>(cameras.size()); }
    int32_t num_points() const { return static_cast<int32_t>(xyz.size() / 3); }
    int64_t num_observations() const { return static_cast<int64_t>(images.size()); }
    bool operator==(const Data& other) const {
        return models == other.models && cameras == other.cameras && images == other.images &&
               points == other.points && params == other.params && poses == other.poses &&
               xyz == other.xyz && xy == other.xy;
    }
};

inline Data data_of(const Problem& problem) {
    const clba_problem_info info = info_of(problem);
    Data data;
    data.models.resize(static_cast<size_t>(info.num_cameras));
    EXPECT_OK(clba_problem_get_cameras(problem.get(), 0, info.num_cameras, data.models.data(), 0,
                                       nullptr, 0));
    size_t num_params = 0;
    for (int32_t model : data.models)
        num_params += static_cast<size_t>(clba_camera_model_num_params(model));
    data.params.resize(num_params);
    EXPECT_OK(clba_problem_get_cameras(problem.get(), 0, info.num_cameras, nullptr, 0,
                                       data.params.data(), 0));
    data.cameras.resize(static_cast<size_t>(info.num_images));
    data.poses.resize(7 * data.cameras.size());
    EXPECT_OK(clba_problem_get_images(problem.get(), 0, info.num_images, data.cameras.data(), 0,
                                      data.poses.data(), 0));
    data.xyz.resize(3 * static_cast<size_t>(info.num_points));
    EXPECT_OK(clba_problem_get_points(problem.get(), 0, info.num_points, data.xyz.data(), 0));
    data.images.resize(static_cast<size_t>(info.num_observations));
    data.points.resize(data.images.size());
    data.xy.resize(2 * data.images.size());
    EXPECT_OK(clba_problem_get_observations(problem.get(), 0, info.num_observations,
                                            data.images.data(), 0, data.points.data(), 0,
                                            data.xy.data(), 0));
    return data;
}

inline Problem problem_of(const Data& data) {
    clba_problem* made = nullptr;
    EXPECT_OK(clba_problem_create(&made));
    Problem problem(made);
    EXPECT_OK(clba_problem_set_cameras(made, data.num_cameras(), data.models.data(), 0,
                                       data.params.data(), 0));
    EXPECT_OK(clba_problem_set_images(made, data.num_images(), data.cameras.data(), 0,
                                      data.poses.data(), 0));
    EXPECT_OK(clba_problem_set_points(made, data.num_points(), data.xyz.data(), 0));
    EXPECT_OK(clba_problem_set_observations(made, data.num_observations(), data.images.data(), 0,
                                            data.points.data(), 0, data.xy.data(), 0));
    return problem;
}

struct Scene {
    Problem start, truth;
};

inline Scene generate(double outlier_share = 0, int32_t num_images = 8,
                      int32_t observations_per_image = 60, uint64_t seed = 1) {
    clba_scene_options options;
    EXPECT_OK(clba_scene_options_init(&options, sizeof options));
    options.num_images = num_images;
    options.observations_per_image = observations_per_image;
    options.outlier_share = outlier_share;
    options.seed = seed;
    clba_problem *start = nullptr, *truth = nullptr;
    EXPECT_OK(clba_problem_generate(&options, &start, &truth));
    return {Problem(start), Problem(truth)};
}

// The same pictures by other models: OpenCV's cameras look along +z and have y downwards. Camera 0
// becomes a radial one, camera 1 an opencv one that images 1 and 2 share, camera 2 is used by no
// image; the others stay.
inline Data with_other_models(const Data& snavely) {
    Data data = snavely;
    data.params.clear();
    for (size_t i = 0; i < data.models.size(); ++i) {
        const double* p = snavely.params.data() + 3 * i;
        if (i == 0) {
            data.models[i] = CLBA_CAMERA_RADIAL;
            data.params.insert(data.params.end(), {p[0], 0, 0, p[1], p[2]});
        } else if (i == 1) {
            data.models[i] = CLBA_CAMERA_OPENCV;
            data.params.insert(data.params.end(), {p[0], p[0], 0, 0, p[1], p[2], 0, 0});
        } else {
            data.params.insert(data.params.end(), p, p + 3);
        }
    }
    data.cameras[2] = 1;
    for (size_t i = 0; i < 3; ++i) {
        double* pose = data.poses.data() + 7 * i;
        // (0, 1, 0, 0) q: half a turn about x after q.
        const std::array<double, 4> q{pose[0], pose[1], pose[2], pose[3]};
        pose[0] = -q[1];
        pose[1] = q[0];
        pose[2] = -q[3];
        pose[3] = q[2];
        pose[5] = -pose[5];
        pose[6] = -pose[6];
    }
    for (size_t i = 0; i < data.images.size(); ++i)
        if (data.images[i] < 3) data.xy[2 * i + 1] = -data.xy[2 * i + 1];
    return data;
}

inline clba_solver_options solver_options() {
    clba_solver_options options;
    EXPECT_OK(clba_solver_options_init(&options, sizeof options));
    return options;
}
// Tolerances that let different solvers meet in all digits that are compared.
inline clba_solver_options converged_options() {
    clba_solver_options options = solver_options();
    options.max_num_iterations = 200;
    options.function_tolerance = 1e-14;
    return options;
}

inline clba_summary solve(const Problem& problem, const Context& context,
                          const clba_solver_options& options) {
    clba_result* result = nullptr;
    EXPECT_OK(clba_problem_solve(problem.get(), context.get(), &options, &result));
    const Result owner(result);
    clba_summary summary{};
    summary.struct_size = sizeof summary;
    EXPECT_OK(clba_result_get_summary(result, &summary));
    return summary;
}

inline double cost_of(const Problem& problem, const Context& context) {
    clba_evaluation evaluation;
    EXPECT_OK(clba_evaluation_init(&evaluation, sizeof evaluation));
    EXPECT_OK(clba_problem_evaluate(problem.get(), context.get(), &evaluation));
    return evaluation.cost;
}

}  // namespace clba_test
