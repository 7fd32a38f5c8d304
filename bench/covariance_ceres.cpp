// SPDX-License-Identifier: Apache-2.0
// Covariances of clba and of ceres::Covariance at the truth of a scene with two constant images:
//   bench/covariance_ceres SCENE IMAGES OBSERVATIONS_PER_IMAGE
// Ceres' parameters of a pose are clba's tangent there, so that all blocks can be compared.
#include <ceres/ceres.h>
#include <ceres/covariance.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <chrono>
#include <clba/clba.hpp>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace {

// P = exp(w) (R X + t) + v; pixel f (1 + k1 r2 + k2 r2^2) u with u = -P / P.z.
struct Residual {
    const double* pose;
    const double* pixel;

    template <class T>
    bool operator()(const T* tangent, const T* intrinsics, const T* point, T* residual) const {
        const T quaternion[4] = {T(pose[0]), T(pose[1]), T(pose[2]), T(pose[3])};
        T before[3], p[3];
        ceres::UnitQuaternionRotatePoint(quaternion, point, before);
        for (int k = 0; k < 3; ++k) before[k] += pose[4 + k];
        ceres::AngleAxisRotatePoint(tangent, before, p);
        for (int k = 0; k < 3; ++k) p[k] += tangent[3 + k];
        const T u = -p[0] / p[2], v = -p[1] / p[2], r2 = u * u + v * v;
        const T factor = intrinsics[0] * (1.0 + r2 * (intrinsics[1] + r2 * intrinsics[2]));
        residual[0] = factor * u - pixel[0];
        residual[1] = factor * v - pixel[1];
        return true;
    }
};

// In units of the standard deviations.
double difference(const double* got, const double* expected, size_t size) {
    double largest = 0;
    for (size_t i = 0; i < size; ++i)
        for (size_t j = 0; j < size; ++j)
            largest =
                std::max(largest, std::abs(got[i * size + j] - expected[i * size + j]) /
                                      std::sqrt(expected[i * size + i] * expected[j * size + j]));
    return largest;
}

double seconds_since(std::chrono::steady_clock::time_point start) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

void compare(const std::string& name, int32_t num_images, int32_t per_image) {
    clba::SceneOptions options;
    for (int32_t scene : {CLBA_SCENE_HALL, CLBA_SCENE_STREET, CLBA_SCENE_LANDMARK})
        if (name == clba::scene_name(scene)) options.scene = scene;
    options.num_images = num_images;
    options.observations_per_image = per_image;
    clba::Problem problem = std::move(clba::generate(options).truth);
    std::vector<int32_t> flags(static_cast<size_t>(num_images), 0);
    flags.front() = flags.back() = CLBA_CONSTANT_POSE;
    problem.set_constant_images(flags);

    const clba::Context context;
    clba::CovarianceOptions covariance_options;
    covariance_options.all_points = 1;
    problem.covariance(context, covariance_options);  // compiles kernels
    const auto our_start = std::chrono::steady_clock::now();
    const clba::Covariance ours = problem.covariance(context, covariance_options);
    const double our_seconds = seconds_since(our_start);

    const clba::Images images = problem.images();
    clba::Cameras cameras = problem.cameras();
    auto points = problem.points();
    const clba::Observations observations = problem.observations();
    std::vector<std::array<double, 6>> tangents(images.poses.size());
    const auto params = [&](size_t image) { return cameras.params.data() + 3 * image; };
    ceres::Problem theirs;
    for (size_t i = 0; i < observations.xy.size(); ++i) {
        const auto image = static_cast<size_t>(observations.images[i]);
        const auto point = static_cast<size_t>(observations.points[i]);
        if (!std::isfinite(ours.point(observations.points[i])[0])) continue;
        theirs.AddResidualBlock(new ceres::AutoDiffCostFunction<Residual, 2, 6, 3, 3>(new Residual{
                                    images.poses[image].data(), observations.xy[i].data()}),
                                nullptr, tangents[image].data(), params(image),
                                points[point].data());
    }
    theirs.SetParameterBlockConstant(tangents.front().data());
    theirs.SetParameterBlockConstant(tangents.back().data());
    std::vector<std::pair<const double*, const double*>> blocks;
    for (size_t i = 0; i < tangents.size(); ++i) {
        if (flags[i] == 0) blocks.emplace_back(tangents[i].data(), tangents[i].data());
        blocks.emplace_back(params(i), params(i));
    }
    for (auto& point : points)
        if (theirs.HasParameterBlock(point.data())) blocks.emplace_back(point.data(), point.data());
    ceres::Covariance covariance{ceres::Covariance::Options()};
    const auto their_start = std::chrono::steady_clock::now();
    if (!covariance.Compute(blocks, &theirs)) throw std::runtime_error("Ceres computed nothing");
    const double their_seconds = seconds_since(their_start);

    double poses = 0, intrinsics = 0, of_points = 0;
    for (size_t i = 0; i < tangents.size(); ++i) {
        std::array<double, 36> pose;
        std::array<double, 9> camera;
        if (flags[i] == 0) {
            covariance.GetCovarianceBlock(tangents[i].data(), tangents[i].data(), pose.data());
            poses = std::max(poses,
                             difference(ours.pose(static_cast<int64_t>(i)).data(), pose.data(), 6));
        }
        covariance.GetCovarianceBlock(params(i), params(i), camera.data());
        const std::vector<double> our_camera =
            ours.block(CLBA_BLOCK_INTRINSICS, static_cast<int64_t>(i), 3);
        intrinsics = std::max(intrinsics, difference(our_camera.data(), camera.data(), 3));
    }
    for (size_t p = 0; p < points.size(); ++p) {
        if (!theirs.HasParameterBlock(points[p].data())) continue;
        std::array<double, 9> block;
        covariance.GetCovarianceBlock(points[p].data(), points[p].data(), block.data());
        of_points = std::max(
            of_points, difference(ours.point(static_cast<int64_t>(p)).data(), block.data(), 3));
    }
    std::printf(
        "%s, %d images, %zu points, %zu observations: clba %.3f s, Ceres %.3f s; largest "
        "differences in standard deviations: poses %.1e, intrinsics %.1e, points %.1e\n",
        name.c_str(), num_images, points.size(), observations.xy.size(), our_seconds, their_seconds,
        poses, intrinsics, of_points);
}

}  // namespace

int main(int argc, char** argv) try {
    if (argc != 4) throw std::invalid_argument("SCENE IMAGES OBSERVATIONS_PER_IMAGE are needed");
    compare(argv[1], std::atoi(argv[2]), std::atoi(argv[3]));
    return EXIT_SUCCESS;
} catch (const std::exception& error) {
    std::fprintf(stderr, "covariance_ceres: %s\n", error.what());
    return EXIT_FAILURE;
}
