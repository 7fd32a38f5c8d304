// SPDX-License-Identifier: Apache-2.0
// Priors through clba.h: formats, errors, and what they add to costs, gradients and summaries.
#include <algorithm>
#include <limits>
#include <string>
#include <vector>

#include "api_rig.hpp"

namespace clba_test {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double nan = std::numeric_limits<double>::quiet_NaN();

template <size_t n>
std::array<double, n * n> diagonal(const std::array<double, n>& variances) {
    std::array<double, n * n> matrix{};
    for (size_t k = 0; k < n; ++k) matrix[(n + 1) * k] = variances[k];
    return matrix;
}
const std::array<double, 9> unit3 = diagonal<3>({1, 1, 1});
const std::array<double, 36> unit6 = diagonal<6>({1, 1, 1, 1, 1, 1});

class Priors : public testing::Test {
protected:
    Scene scene = generate();
    clba_problem* p = scene.start.get();
    Context context = make_context();
    Data data = data_of(scene.start);
    double bare = cost_of(scene.start, context);

    double added() { return cost_of(scene.start, context) - bare; }
    std::vector<double> centers() {
        std::vector<double> all(3 * data.cameras.size());
        EXPECT_OK(clba_problem_get_centers(p, 0, data.num_images(), all.data(), 0));
        return all;
    }
};

// Sums of squares by hand; L of [4, 2; 2, 5] is [2, 0; 1, 2].
TEST_F(Priors, AddTheirSquaresToTheCost) {
    const double rounding = 1e-13 * bare;
    std::vector<double> centers = Priors::centers();
    const int32_t image = 5;
    const double target[] = {centers[15] - 2, centers[16] - 5,
                             centers[17] + 3};  // h less: 2, 5, -3
    const std::array<double, 9> covariance = {4, 2, 0, 2, 5, 0, 0, 0, 9};
    ASSERT_OK(clba_problem_set_position_priors(p, 1, &image, 0, target, 0, covariance.data(), 0));
    EXPECT_NEAR(added(), 0.5 * (1 + 4 + 1), rounding);
    ASSERT_OK(clba_problem_set_position_priors(p, 0, nullptr, 0, nullptr, 0, nullptr, 0));
    EXPECT_EQ(added(), 0);

    const int32_t point = 7;
    const double place[] = {data.xyz[21] - 2, data.xyz[22] - 5, data.xyz[23] + 3};
    ASSERT_OK(clba_problem_set_point_priors(p, 1, &point, 0, place, 0, covariance.data(), 0));
    EXPECT_NEAR(added(), 0.5 * (1 + 4 + 1), rounding);
    ASSERT_OK(clba_problem_set_point_priors(p, 0, nullptr, 0, nullptr, 0, nullptr, 0));

    // f is 6 off with the deviation 2; k1 is not held; k2 is what it is.
    const int32_t camera = 3;
    const double params[] = {data.params[9] + 6, 1e3, data.params[11]};
    const std::array<double, 9> variances = diagonal<3>({4, infinity, 1e-4});
    ASSERT_OK(clba_problem_set_intrinsics_priors(p, 1, &camera, 0, params, 0, variances.data(), 0));
    EXPECT_NEAR(added(), 4.5, rounding);
    ASSERT_OK(clba_problem_set_intrinsics_priors(p, 0, nullptr, 0, nullptr, 0, nullptr, 0));

    // The same pose with its quaternion times -2, then moved by 3 along the camera's z axis.
    std::array<double, 7> pose;
    std::copy_n(&data.poses[14], 7, pose.begin());
    for (size_t k = 0; k < 4; ++k) pose[k] *= -2;
    const int32_t second = 2;
    ASSERT_OK(clba_problem_set_pose_priors(p, 1, &second, 0, pose.data(), 0, unit6.data(), 0));
    EXPECT_NEAR(added(), 0, rounding);
    pose[6] += 3;
    ASSERT_OK(clba_problem_set_pose_priors(p, 1, &second, 0, pose.data(), 0, unit6.data(), 0));
    EXPECT_NEAR(added(), 4.5, rounding);
    ASSERT_OK(clba_problem_set_pose_priors(p, 0, nullptr, 0, nullptr, 0, nullptr, 0));

    // A pair of equal poses but for 3 along the camera's z axis, measured as equal, twice.
    std::copy_n(&data.poses[0], 7, &data.poses[7]);
    data.poses[13] += 3;
    ASSERT_OK(clba_problem_set_images(p, data.num_images(), data.cameras.data(), 0,
                                      data.poses.data(), 0));
    bare = cost_of(scene.start, context);
    const int32_t pairs[] = {0, 1, 1, 0};
    const double equal[] = {1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0};
    const std::array<double, 36> of_pair = diagonal<6>({1, 1, 1, 1, 1, 9});
    std::vector<double> covariances(of_pair.begin(), of_pair.end());
    covariances.insert(covariances.end(), unit6.begin(), unit6.end());
    ASSERT_OK(
        clba_problem_set_relative_pose_priors(p, 2, pairs, 0, equal, 0, covariances.data(), 0));
    EXPECT_NEAR(added(), 0.5 * (1 + 9), 1e-13 * bare);
}

// Of structs with other fields between, and of cameras of several models.
TEST_F(Priors, TakeRowsOfAnyStride) {
    struct Row {
        int32_t image, other;
        double position[3], sigma, covariance[9];
    };
    std::vector<Row> rows(3);
    const std::vector<double> centers = Priors::centers();
    for (int32_t i = 0; i < 3; ++i) {
        Row& row = rows[static_cast<size_t>(i)];
        row = {2 * i, -1, {}, nan, {}};
        for (size_t k = 0; k < 3; ++k) {
            row.position[k] = centers[6 * static_cast<size_t>(i) + k] + 1;
            row.covariance[4 * k] = 0.25;
        }
    }
    ASSERT_OK(clba_problem_set_position_priors(p, 3, &rows[0].image, sizeof(Row), rows[0].position,
                                               sizeof(Row), rows[0].covariance, sizeof(Row)));
    EXPECT_NEAR(added(), 0.5 * 9 * 4, 1e-13 * bare);

    const Data other = with_other_models(data);
    const Problem problem = problem_of(other);
    const double without = cost_of(problem, context);
    const int32_t cameras[] = {1, 0, 3};  // opencv, radial, snavely
    std::vector<double> params, covariances;
    size_t first[] = {0, 5, 13, 16};
    for (const int32_t camera : cameras) {
        const size_t begin = first[camera];
        const size_t n = static_cast<size_t>(
            clba_camera_model_num_params(other.models[static_cast<size_t>(camera)]));
        for (size_t k = 0; k < n; ++k) {
            params.push_back(other.params[begin + k] + (k == n - 1 ? 1e-3 : 0));
            for (size_t c = 0; c < n; ++c) covariances.push_back(k == c ? 1e-6 : 0);
        }
    }
    ASSERT_OK(clba_problem_set_intrinsics_priors(problem.get(), 3, cameras, 0, params.data(), 0,
                                                 covariances.data(), 0));
    EXPECT_NEAR(cost_of(problem, context) - without, 1.5, 1e-12 * without);
}

// All kinds at once, and a state that is off.
void set_all(clba_problem* p, const Data& data, const std::vector<double>& centers) {
    const int32_t images[] = {0, 3, 6};
    std::vector<double> positions, poses, covariances;
    for (const int32_t image : images)
        for (size_t k = 0; k < 3; ++k)
            positions.push_back(centers[3 * static_cast<size_t>(image) + k] + 0.01);
    for (int i = 0; i < 3; ++i)
        covariances.insert(covariances.end(), {1e-4, 2e-5, 0, 2e-5, 2e-4, 1e-5, 0, 1e-5, 4e-4});
    ASSERT_OK(clba_problem_set_position_priors(p, 3, images, 0, positions.data(), 0,
                                               covariances.data(), 0));
    const int32_t points[] = {4, 9, 1};
    positions.clear();
    for (const int32_t point : points)
        for (size_t k = 0; k < 3; ++k)
            positions.push_back(data.xyz[3 * static_cast<size_t>(point) + k] - 0.01);
    ASSERT_OK(
        clba_problem_set_point_priors(p, 3, points, 0, positions.data(), 0, covariances.data(), 0));
    const int32_t image = 1;
    const std::array<double, 36> of_pose = diagonal<6>({1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3});
    ASSERT_OK(clba_problem_set_pose_priors(p, 1, &image, 0, &data.poses[14], 0, of_pose.data(), 0));
    const int32_t pair[] = {2, 5};
    const double relative[] = {1, 0.1, 0.2, -0.1, 1, 2, 0.5};
    ASSERT_OK(clba_problem_set_relative_pose_priors(p, 1, pair, 0, relative, 0, unit6.data(), 0));
    const int32_t camera = 2;
    const std::array<double, 9> variances = diagonal<3>({25, infinity, 1e-4});
    const double params[] = {data.params[6] + 3, 0, data.params[8] + 0.005};
    ASSERT_OK(clba_problem_set_intrinsics_priors(p, 1, &camera, 0, params, 0, variances.data(), 0));
}

TEST_F(Priors, TheGradientIsThatOfTheCost) {
    set_all(p, data, centers());
    const auto n = static_cast<size_t>(info_of(scene.start).num_parameters);
    std::vector<double> gradient(n);
    clba_evaluation evaluation;
    ASSERT_OK(clba_evaluation_init(&evaluation, sizeof evaluation));
    evaluation.gradient = gradient.data();
    ASSERT_OK(clba_problem_evaluate(p, context.get(), &evaluation));
    // Along a direction in which all parameters move, each in its units.
    std::vector<double> direction(n);
    for (size_t k = 0; k < n; ++k)
        direction[k] = std::sin(1.0 + static_cast<double>(k)) / (1 + std::abs(gradient[k]));
    double slope = 0;
    for (size_t k = 0; k < n; ++k) slope += gradient[k] * direction[k];
    const auto cost_at = [&](double step) {
        const Problem moved = problem_of(data);
        set_all(moved.get(), data, centers());
        std::vector<double> scaled = direction;
        for (double& value : scaled) value *= step;
        EXPECT_OK(clba_problem_apply_step(moved.get(), scaled.data()));
        return cost_of(moved, context);
    };
    const double h = 1e-4;
    const double expected =
        (8 * (cost_at(h) - cost_at(-h)) - (cost_at(2 * h) - cost_at(-2 * h))) / (12 * h);
    EXPECT_NEAR(slope, expected, 1e-5 * std::abs(expected));
}

TEST_F(Priors, TheSummaryTellsTheirCostAndTheGauge) {
    EXPECT_EQ(solve(problem_of(data), context, solver_options()).num_gauge_freedoms, 7);
    set_all(p, data, centers());
    const double prior_cost = added();
    clba_result* made = nullptr;
    const clba_solver_options options = solver_options();
    ASSERT_OK(clba_problem_solve(p, context.get(), &options, &made));
    const Result result(made);
    clba_summary summary{};
    summary.struct_size = sizeof summary;
    ASSERT_OK(clba_result_get_summary(made, &summary));
    EXPECT_NEAR(summary.initial_prior_cost, prior_cost, 1e-12 * bare);
    EXPECT_GT(summary.final_prior_cost, 0);
    EXPECT_LT(summary.final_prior_cost, summary.initial_prior_cost);
    EXPECT_NEAR(summary.final_cost, cost_of(scene.start, context), 1e-12 * summary.final_cost);
    EXPECT_NEAR(summary.reference_final_cost, summary.final_cost, 1e-9 * summary.final_cost);
    EXPECT_EQ(summary.gauge, CLBA_GAUGE_STATE_FIXED_BY_PRIORS);
    EXPECT_EQ(summary.num_gauge_freedoms, 0);
    const std::string report = clba_result_report(made), json = clba_result_json(made);
    EXPECT_NE(report.find("fixed_by_priors"), std::string::npos);
    EXPECT_NE(report.find("of priors, final"), std::string::npos);
    EXPECT_NE(json.find("\"gauge\": \"fixed_by_priors\""), std::string::npos);
    EXPECT_NE(json.find("\"final_prior_cost\""), std::string::npos);
}

TEST_F(Priors, GoWithTheRowsTheyAreAbout) {
    set_all(p, data, centers());
    const double all = added();
    // As many rows as before keep them.
    ASSERT_OK(clba_problem_set_cameras(p, data.num_cameras(), data.models.data(), 0,
                                       data.params.data(), 0));
    ASSERT_OK(clba_problem_set_images(p, data.num_images(), data.cameras.data(), 0,
                                      data.poses.data(), 0));
    ASSERT_OK(clba_problem_set_points(p, data.num_points(), data.xyz.data(), 0));
    EXPECT_NEAR(added(), all, 1e-12 * bare);
    const auto replace_observations = [&] {
        ASSERT_OK(clba_problem_set_observations(p, data.num_observations(), data.images.data(), 0,
                                                data.points.data(), 0, data.xy.data(), 0));
    };
    ASSERT_OK(clba_problem_set_points(p, 1, data.xyz.data(), 0));
    ASSERT_OK(clba_problem_set_points(p, data.num_points(), data.xyz.data(), 0));
    replace_observations();
    const double without_points = added();
    EXPECT_LT(without_points, all - 0.01);
    ASSERT_OK(clba_problem_set_images(p, 1, data.cameras.data(), 0, data.poses.data(), 0));
    ASSERT_OK(clba_problem_set_images(p, data.num_images(), data.cameras.data(), 0,
                                      data.poses.data(), 0));
    replace_observations();
    const double of_intrinsics = 0.5 * (9.0 / 25 + 0.25);
    EXPECT_NEAR(added(), of_intrinsics, 1e-12 * bare);
    std::vector<int32_t> models(data.models.size(), CLBA_CAMERA_SIMPLE_PINHOLE);
    ASSERT_OK(
        clba_problem_set_cameras(p, data.num_cameras(), models.data(), 0, data.params.data(), 0));
    ASSERT_OK(clba_problem_set_cameras(p, data.num_cameras(), data.models.data(), 0,
                                       data.params.data(), 0));
    EXPECT_NEAR(added(), 0, 1e-12 * bare);
}

TEST_F(Priors, RefuseWhatIsWrong) {
    const int32_t images[] = {0, 1, 2};
    const double positions[9] = {};
    std::vector<double> covariances;
    for (int i = 0; i < 3; ++i) covariances.insert(covariances.end(), unit3.begin(), unit3.end());
    const auto set = [&](const int32_t* indices, const double* targets, const double* matrices,
                         int32_t count = 3) {
        return clba_problem_set_position_priors(p, count, indices, 0, targets, 0, matrices, 0);
    };
    ASSERT_OK(set(images, positions, covariances.data()));
    const double kept = added();
    EXPECT_TRUE(
        refused(clba_problem_set_position_priors(nullptr, 0, nullptr, 0, nullptr, 0, nullptr, 0),
                {"problem"}));
    EXPECT_TRUE(refused(set(nullptr, positions, covariances.data()), {"images"}));
    EXPECT_TRUE(refused(set(images, nullptr, covariances.data()), {"positions"}));
    EXPECT_TRUE(refused(set(images, positions, nullptr), {"covariances"}));
    EXPECT_TRUE(refused(set(images, positions, covariances.data(), -1), {"count = -1"}));
    const int32_t outside[] = {0, 8, 2}, twice[] = {0, 4, 0};
    EXPECT_TRUE(
        refused(set(outside, positions, covariances.data()), {"images[1] = 8", "num_images = 8"}));
    EXPECT_TRUE(refused(set(twice, positions, covariances.data()), {"images[2] = 0", "images[0]"}));
    const double bad_positions[] = {0, 0, 0, 0, nan, 0, 0, 0, 0};
    EXPECT_TRUE(refused(set(images, bad_positions, covariances.data()), {"positions[1][1] = nan"}));
    const auto with = [&](size_t k, double value) {
        std::vector<double> changed = covariances;
        changed[k] = value;
        return changed;
    };
    for (const double variance : {0.0, -1.0, nan, infinity})
        EXPECT_TRUE(refused(set(images, positions, with(13, variance).data()),
                            {"covariances[1][1][1]", "> 0"}));
    EXPECT_TRUE(refused(set(images, positions, with(10, 0.5).data()),
                        {"covariances[1][0][1] = 0.5", "[1][0] = 0", "symmetric"}));
    std::vector<double> indefinite = with(10, 2);
    indefinite[12] = 2;
    EXPECT_TRUE(refused(set(images, positions, indefinite.data()),
                        {"covariances[1]", "positive definite"}));
    EXPECT_TRUE(refused(
        clba_problem_set_position_priors(p, 3, images, 0, positions, 8, covariances.data(), 0),
        {"positions", "stride of 8"}));

    const double zero_quaternion[7] = {};
    EXPECT_TRUE(
        refused(clba_problem_set_pose_priors(p, 1, images, 0, zero_quaternion, 0, unit6.data(), 0),
                {"poses[0]", "quaternion"}));
    const double identity[7] = {1};
    const int32_t same[] = {3, 3}, beyond[] = {0, 9};
    EXPECT_TRUE(
        refused(clba_problem_set_relative_pose_priors(p, 1, same, 0, identity, 0, unit6.data(), 0),
                {"pairs[0] = (3, 3)"}));
    EXPECT_TRUE(refused(
        clba_problem_set_relative_pose_priors(p, 1, beyond, 0, identity, 0, unit6.data(), 0),
        {"pairs[0][1] = 9", "num_images = 8"}));
    const int32_t point = data.num_points();
    EXPECT_TRUE(
        refused(clba_problem_set_point_priors(p, 1, &point, 0, positions, 0, unit3.data(), 0),
                {"points[0]", "num_points"}));
    std::array<double, 9> beside_infinity = diagonal<3>({1, infinity, 1});
    beside_infinity[1] = beside_infinity[3] = 0.1;
    EXPECT_TRUE(refused(clba_problem_set_intrinsics_priors(p, 1, images, 0, positions, 0,
                                                           beside_infinity.data(), 0),
                        {"covariances[0][0][1] = 0.1", "infinity"}));
    const int32_t camera = 8;
    EXPECT_TRUE(
        refused(clba_problem_set_intrinsics_priors(p, 1, &camera, 0, positions, 0, unit3.data(), 0),
                {"cameras[0] = 8", "num_cameras = 8"}));
    // An error leaves what was there.
    EXPECT_EQ(added(), kept);
}

TEST(Gauge, HasNames) {
    EXPECT_STREQ(clba_gauge_state_name(CLBA_GAUGE_STATE_FREE), "free");
    EXPECT_STREQ(clba_gauge_state_name(CLBA_GAUGE_STATE_FIXED_BY_CONSTANTS), "fixed_by_constants");
    EXPECT_STREQ(clba_gauge_state_name(CLBA_GAUGE_STATE_FIXED_BY_PRIORS), "fixed_by_priors");
    EXPECT_EQ(clba_gauge_state_name(3), nullptr);
    EXPECT_EQ(clba_gauge_state_name(-1), nullptr);
}

}  // namespace
}  // namespace clba_test
