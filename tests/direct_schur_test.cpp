// SPDX-License-Identifier: Apache-2.0
#include "reference/direct_schur.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <cstdlib>
#include <limits>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "base/error.hpp"
#include "reference/sparse_cholesky.hpp"

namespace clba {
namespace {

using reference::DirectSchur;
using reference::Jacobian;
using reference::SparseCholesky;

constexpr double epsilon = std::numeric_limits<double>::epsilon();
constexpr uint8_t constant_pose = constant_rotation | constant_position;
constexpr double nan = std::numeric_limits<double>::quiet_NaN();

// Sets CLBA_CHOLMOD, and back to what it was.
class PluginPath {
public:
    explicit PluginPath(const std::string& path) {
        if (const char* old = std::getenv(name)) old_ = old;
        ::setenv(name, path.c_str(), 1);
    }
    ~PluginPath() {
        if (old_)
            ::setenv(name, old_->c_str(), 1);
        else
            ::unsetenv(name);
    }

private:
    static constexpr const char* name = "CLBA_CHOLMOD";
    std::optional<std::string> old_;
};

std::string open_error(int32_t version = CLBA_CHOLMOD_VERSION) {
    try {
        reference::open_cholmod_plugin(version);
    } catch (const Error& error) {
        EXPECT_EQ(error.status(), Status::no_plugin);
        return error.what();
    }
    return "";
}

Camera camera_of(CameraModelNumber model) {
    Camera camera;
    camera.model = model;
    return camera;
}

// Images refer to cameras in the order given; points and observations are random.
Problem random_problem(const std::vector<CameraModelNumber>& models,
                       const std::vector<int32_t>& cameras, int num_points, int num_observations,
                       std::mt19937& random) {
    Problem problem;
    for (const CameraModelNumber model : models) problem.cameras.push_back(camera_of(model));
    for (const int32_t camera : cameras) problem.images.push_back({camera, {}});
    problem.points.resize(num_points);
    for (int i = 0; i < num_observations; ++i) {
        const auto image = static_cast<int32_t>(random() % cameras.size());
        const auto point = static_cast<int32_t>(random() % num_points);
        problem.observations.push_back({image, point, 0, 0});
    }
    return problem;
}

// A linear system that does not come from any geometry: all the solver may rely on is the pattern.
struct System {
    Jacobian jacobian;
    std::vector<double> gradient;
    std::vector<double> damping;
};

System random_system(const Problem& problem, const ParameterLayout& layout, std::mt19937& random) {
    std::uniform_real_distribution<double> uniform(-1, 1);
    const int columns = layout.max_image_columns;
    System system;
    system.jacobian.columns = columns;
    for (const Observation& seen : problem.observations) {
        system.jacobian.image.push_back(seen.image);
        system.jacobian.point.push_back(seen.point);
        const int32_t camera = problem.images[seen.image].camera;
        for (int row = 0; row < 2; ++row) {
            for (int c = 0; c < columns; ++c) {
                const int k = c - num_pose_params;
                const int32_t offset = k < 0 ? layout.pose_offset[seen.image] + c
                                             : layout.intrinsics_offset[camera] + k;
                const bool is_used = k < problem.cameras[camera].num_params();
                system.jacobian.image_blocks.push_back(
                    is_used && layout.scale[offset] > 0 ? uniform(random) : 0);
            }
            for (int c = 0; c < 3; ++c)
                system.jacobian.point_blocks.push_back(
                    point_scale(problem, seen.point)[c] > 0 ? uniform(random) : 0);
        }
    }
    for (int64_t k = 0; k < layout.num_parameters(problem); ++k) {
        system.gradient.push_back(uniform(random));
        system.damping.push_back(0.2 + 0.1 * uniform(random));
    }
    return system;
}

Eigen::MatrixXd dense_jacobian(const Problem& problem, const ParameterLayout& layout,
                               const Jacobian& jacobian) {
    Eigen::MatrixXd dense =
        Eigen::MatrixXd::Zero(2 * jacobian.num_observations(), layout.num_parameters(problem));
    for (int64_t i = 0; i < 2 * jacobian.num_observations(); ++i) {
        const int32_t image = jacobian.image[i / 2];
        const int32_t camera = problem.images[image].camera;
        const double* f = &jacobian.image_blocks[i * jacobian.columns];
        for (int c = 0; c < num_pose_params; ++c) dense(i, layout.pose_offset[image] + c) = f[c];
        for (int k = 0; k < problem.cameras[camera].num_params(); ++k)
            dense(i, layout.intrinsics_offset[camera] + k) = f[num_pose_params + k];
        for (int c = 0; c < 3; ++c)
            dense(i, layout.num_f + 3 * jacobian.point[i / 2] + c) =
                jacobian.point_blocks[3 * i + c];
    }
    return dense;
}

std::vector<bool> free_parameters(const Problem& problem, const ParameterLayout& layout) {
    std::vector<bool> is_free;
    for (const double scale : layout.scale) is_free.push_back(scale > 0);
    for (int32_t p = 0; p < problem.num_points(); ++p)
        for (const double scale : point_scale(problem, p)) is_free.push_back(scale > 0);
    return is_free;
}

// Solves twice with one structure and compares with a dense factorisation of all normal equations.
void expect_dense_solution(const Problem& problem, std::mt19937& random) {
    const ParameterLayout layout(problem);
    const std::vector<bool> is_free = free_parameters(problem, layout);
    DirectSchur direct(problem, layout);
    for (int repeat = 0; repeat < 2; ++repeat) {
        const System system = random_system(problem, layout, random);
        const Eigen::MatrixXd j = dense_jacobian(problem, layout, system.jacobian);
        const Eigen::Index n = j.cols();
        Eigen::MatrixXd h = j.transpose() * j;
        Eigen::VectorXd right(n);
        for (Eigen::Index k = 0; k < n; ++k) {
            h(k, k) = is_free[k] ? h(k, k) + system.damping[k] : 1;
            right[k] = is_free[k] ? -system.gradient[k] : 0;
        }
        const Eigen::VectorXd expected = h.ldlt().solve(right);
        const Eigen::VectorXd eigenvalues =
            Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(h, Eigen::EigenvaluesOnly).eigenvalues();
        const double condition = eigenvalues[n - 1] / eigenvalues[0];
        ASSERT_LT(condition, 1e4);

        Eigen::VectorXd delta = Eigen::VectorXd::Constant(n, nan);
        ASSERT_TRUE(direct.solve(system.jacobian, system.gradient.data(), system.damping.data(), {},
                                 delta.data()));
        EXPECT_EQ(direct.num_indefinite(), 0);
        EXPECT_LE((delta - expected).norm(), 20 * epsilon * condition * expected.norm());
        for (Eigen::Index k = 0; k < n; ++k) {
            if (!is_free[k]) {
                EXPECT_EQ(delta[k], 0) << "parameter " << k;
            }
        }
    }
}

std::vector<int32_t> own_cameras(int count) {
    std::vector<int32_t> cameras(count);
    for (int i = 0; i < count; ++i) cameras[i] = i;
    return cameras;
}

TEST(DirectSchur, OwnCameras) {
    std::mt19937 random(1);
    const std::vector<CameraModelNumber> models(7, camera_snavely);
    expect_dense_solution(random_problem(models, own_cameras(7), 30, 120, random), random);
}

TEST(DirectSchur, OwnCamerasOfAllModels) {
    std::mt19937 random(2);
    std::vector<CameraModelNumber> models;
    for (int32_t model = num_camera_models - 1; model >= 0; --model)
        models.push_back(static_cast<CameraModelNumber>(model));
    expect_dense_solution(random_problem(models, own_cameras(num_camera_models), 60, 240, random),
                          random);
}

TEST(DirectSchur, OneSharedCamera) {
    std::mt19937 random(3);
    expect_dense_solution(random_problem({camera_simple_radial}, {0, 0, 0, 0, 0}, 25, 80, random),
                          random);
}

TEST(DirectSchur, SharedOwnAndUnusedCameras) {
    std::mt19937 random(4);
    const std::vector<CameraModelNumber> models{camera_radial, camera_snavely, camera_opencv,
                                                camera_pinhole};
    expect_dense_solution(random_problem(models, {2, 0, 1, 2, 0, 0}, 25, 90, random), random);
}

TEST(DirectSchur, RepeatedPairs) {
    std::mt19937 random(5);
    for (const std::vector<int32_t>& cameras : {std::vector<int32_t>{0, 1, 2}, {0, 0, 1}}) {
        Problem problem = random_problem(std::vector<CameraModelNumber>(3, camera_snavely), cameras,
                                         6, 40, random);
        problem.observations.push_back(problem.observations[3]);
        problem.observations.push_back(problem.observations[3]);
        expect_dense_solution(problem, random);
    }
}

TEST(DirectSchur, UnobservedImagesAndPoints) {
    std::mt19937 random(6);
    Problem problem = random_problem({camera_snavely, camera_simple_radial, camera_snavely},
                                     {0, 1, 1, 2}, 12, 40, random);
    for (Observation& seen : problem.observations) {
        if (seen.image == 0 || seen.image == 2) ++seen.image;
        if (seen.point == 0 || seen.point == 11) seen.point = 5;
    }
    expect_dense_solution(problem, random);
}

TEST(DirectSchur, Constants) {
    std::mt19937 random(7);
    const std::vector<CameraModelNumber> models{camera_simple_radial, camera_snavely, camera_radial,
                                                camera_pinhole, camera_snavely};
    Problem problem = random_problem(models, {0, 0, 1, 2, 2, 3, 4, 0}, 25, 150, random);
    problem.constant_images = {
        constant_pose, constant_rotation, constant_position, 0, constant_pose, constant_pose, 0, 0};
    problem.constant_cameras = {0b0110, 0b001, 0b11111, 0b1111, 0};
    problem.constant_points.assign(25, 0);
    for (const int32_t p : {0, 3, 24}) problem.constant_points[p] = 1;
    // Image 7 sees constant points only: its pose and its shared camera meet in no other way.
    for (Observation& seen : problem.observations)
        if (seen.image == 7) seen.point = 3;
    expect_dense_solution(problem, random);

    problem.constant_points.assign(25, 1);
    expect_dense_solution(problem, random);
}

TEST(DirectSchur, NoObservations) {
    std::mt19937 random(8);
    expect_dense_solution(random_problem({camera_snavely}, {0}, 2, 0, random), random);
}

TEST(DirectSchur, PointsAlone) {
    Problem problem;
    problem.points.resize(1);
    DirectSchur direct(problem, ParameterLayout(problem));
    const std::array<double, 3> gradient{2, -4, 1}, damping{1, 2, 4};
    std::array<double, 3> delta{};
    ASSERT_TRUE(direct.solve({}, gradient.data(), damping.data(), {}, delta.data()));
    EXPECT_DOUBLE_EQ(delta[0], -2);
    EXPECT_DOUBLE_EQ(delta[1], 2);
    EXPECT_DOUBLE_EQ(delta[2], -0.25);
}

TEST(DirectSchur, CouplesOnlyCovisibleBlocks) {
    Problem problem;
    problem.cameras.assign(3, camera_of(camera_snavely));
    for (int32_t i = 0; i < 3; ++i) problem.images.push_back({i, {}});
    problem.points.resize(3);
    problem.observations = {{0, 0, 0, 0}, {1, 0, 0, 0}, {0, 1, 0, 0},
                            {1, 1, 0, 0}, {2, 2, 0, 0}, {1, 2, 0, 0}};
    const auto num_nonzeros = [&] {
        return DirectSchur(problem, ParameterLayout(problem)).num_schur_nonzeros();
    };
    EXPECT_EQ(num_nonzeros(), 3 * 45 + 2 * 81);
    problem.constant_points = {0, 0, 1};
    EXPECT_EQ(num_nonzeros(), 3 * 45 + 81);
    problem.constant_images.assign(3, 0);
    problem.constant_images[0] = constant_pose;
    EXPECT_EQ(num_nonzeros(), 3 * 45 + 81);
    problem.constant_cameras = {7, 0, 0};
    EXPECT_EQ(num_nonzeros(), 3 * 45);
}

TEST(DirectSchur, ReportsIndefiniteBlocksAndRecovers) {
    std::mt19937 random(9);
    const std::vector<CameraModelNumber> models(4, camera_snavely);
    const Problem problem = random_problem(models, own_cameras(4), 20, 60, random);
    const ParameterLayout layout(problem);
    DirectSchur direct(problem, layout);
    const System good = random_system(problem, layout, random);
    std::vector<double> delta(good.gradient.size());
    const auto solve = [&](const System& system) {
        return direct.solve(system.jacobian, system.gradient.data(), system.damping.data(), {},
                            delta.data());
    };
    ASSERT_TRUE(solve(good));
    const std::vector<double> expected = delta;

    System bad_points = good;
    bad_points.damping[layout.num_f + 3 * 4 + 1] = -1e3;
    bad_points.damping[layout.num_f + 3 * 7] = nan;
    EXPECT_FALSE(solve(bad_points));
    EXPECT_EQ(direct.num_indefinite(), 2);

    System bad_image = good;
    bad_image.damping[12] = -1e3;
    EXPECT_FALSE(solve(bad_image));
    EXPECT_EQ(direct.num_indefinite(), 1);

    System not_finite = good;
    not_finite.gradient[5] = nan;
    EXPECT_FALSE(solve(not_finite));

    not_finite = good;
    not_finite.jacobian.image_blocks[5] = nan;
    EXPECT_FALSE(solve(not_finite));

    ASSERT_TRUE(solve(good));
    EXPECT_EQ(direct.num_indefinite(), 0);
    EXPECT_EQ(delta, expected);
}

TEST(DirectSchur, RefusesAnotherProblemsJacobian) {
    std::mt19937 random(10);
    const Problem problem = random_problem({camera_snavely}, {0}, 2, 4, random);
    const ParameterLayout layout(problem);
    DirectSchur direct(problem, layout);
    System system = random_system(problem, layout, random);
    system.jacobian.image.pop_back();
    EXPECT_THROW(direct.solve(system.jacobian, system.gradient.data(), system.damping.data(), {},
                              system.gradient.data()),
                 Error);
}

TEST(SparseCholesky, SolvesByHand) {
    // 4 2 0      8
    // 2 5 0  x = 12  for x = 1, 2, 3
    // 0 0 2      6
    SparseCholesky cholesky({0, 2, 3, 4}, {0, 1, 1, 2});
    const std::array<double, 4> values{4, 2, 5, 2};
    ASSERT_TRUE(cholesky.factorize(values.data()));
    std::array<double, 3> x{8, 12, 6};
    cholesky.solve(x.data(), x.data());
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(x[k], k + 1, 8 * epsilon * 3);
    EXPECT_EQ(cholesky.num_factor_nonzeros(), 4);

    const std::array<double, 4> indefinite{4, 5, 5, 2};
    EXPECT_FALSE(cholesky.factorize(indefinite.data()));
}

TEST(CholmodPlugin, NamesPathAndRemedyWhenMissing) {
    const PluginPath path("/nonexistent/clba_cholmod");
    const std::string error = open_error();
    EXPECT_NE(error.find("/nonexistent/clba_cholmod"), std::string::npos) << error;
    EXPECT_NE(error.find("CLBA_BUILD_CHOLMOD"), std::string::npos) << error;
    EXPECT_EQ(error.find("libclba_cholmod.so"), std::string::npos) << error;
}

TEST(CholmodPlugin, RefusesAnotherLibrary) {
    const PluginPath path("libm.so.6");
    EXPECT_NE(open_error().find("no function clba_cholmod_version"), std::string::npos);
}

TEST(CholmodPlugin, RefusesAnotherVersion) {
    EXPECT_EQ(open_error(), "");
    const std::string error = open_error(CLBA_CHOLMOD_VERSION + 1);
    EXPECT_NE(error.find(text("version ", CLBA_CHOLMOD_VERSION)), std::string::npos) << error;
    EXPECT_NE(error.find(text("needs ", CLBA_CHOLMOD_VERSION + 1)), std::string::npos) << error;
}

}  // namespace
}  // namespace clba
