// SPDX-License-Identifier: Apache-2.0
// Covariances: whether they are right, and what they cost. Each prints lines for people.
//   bench/covariance statistics SCENES        the share of true errors inside the 95 % ellipsoids
//   bench/covariance time SCENE IMAGES        seconds and memory at the truth
//   bench/covariance sampled SCENE IMAGES SAMPLES   the same, sampled, and against the exact ones
#include <clba/clba.hpp>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <string>
#include <vector>

namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

int32_t scene_of(const std::string& name) {
    for (int32_t scene : {CLBA_SCENE_HALL, CLBA_SCENE_STREET, CLBA_SCENE_LANDMARK})
        if (name == clba::scene_name(scene)) return scene;
    throw std::invalid_argument("there is no scene " + name);
}

int64_t peak_memory() {
    std::FILE* file = std::fopen("/proc/self/status", "r");
    long kib = 0;
    char line[256];
    while (file && std::fgets(line, sizeof line, file))
        if (std::sscanf(line, "VmHWM: %ld kB", &kib) == 1) break;
    if (file) std::fclose(file);
    return 1024 * int64_t{kib};
}

Matrix3d rotation_of(const std::array<double, 7>& pose) {
    return Eigen::Quaterniond(pose[0], pose[1], pose[2], pose[3]).toRotationMatrix();
}
Eigen::Vector3d center_of(const std::array<double, 7>& pose) {
    return -rotation_of(pose).transpose() * Eigen::Vector3d(pose[4], pose[5], pose[6]);
}

// How often x^T P^-1 x is below the 95 % quantile of its chi-square distribution.
struct Share {
    const char* name;
    double quantile;
    int64_t num_inside = 0, num = 0;
    double sum = 0;
    int degrees = 0;

    // P may have what a gauge holds: directions without variance are left out.
    void add(const VectorXd& error, const MatrixXd& covariance) {
        degrees = static_cast<int>(error.size());
        const VectorXd scale = covariance.diagonal().cwiseSqrt().cwiseInverse();
        if (!scale.allFinite()) return;
        const MatrixXd scaled = scale.asDiagonal() * covariance * scale.asDiagonal();
        const Eigen::LDLT<MatrixXd> factor(scaled);
        if (!(factor.vectorD().minCoeff() > 1e-7)) return;
        const VectorXd whole = scale.asDiagonal() * error;
        const double square = whole.dot(factor.solve(whole));
        ++num;
        sum += square;
        num_inside += square < quantile ? 1 : 0;
    }
    void print() const {
        const double share = static_cast<double>(num_inside) / static_cast<double>(num);
        std::printf("%-12s %8lld errors, %.2f %% inside, mean of x^T P^-1 x / n %.3f\n", name,
                    static_cast<long long>(num), 100 * share,
                    sum / static_cast<double>(num) / degrees);
    }
};

void statistics(int num_scenes) {
    const clba::Context context;
    Share poses{"poses", 12.592}, centers{"centres", 7.815}, intrinsics{"intrinsics", 7.815},
        points{"points", 7.815};
    for (int seed = 1; seed <= num_scenes; ++seed) {
        clba::SceneOptions scene_options;
        scene_options.num_images = 8;
        scene_options.observations_per_image = 60;
        scene_options.num_points = 60;
        scene_options.pixel_noise = 0.3;
        scene_options.seed = static_cast<uint64_t>(seed);
        clba::Scene scene = clba::generate(scene_options);
        const std::vector<double> sigmas(static_cast<size_t>(scene.start.info().num_observations),
                                         0.3);
        scene.start.set_sigmas(sigmas);
        clba::SolverOptions solver;
        solver.precision = CLBA_PRECISION_DOUBLE;
        solver.max_num_iterations = 200;
        solver.function_tolerance = 1e-12;
        const int32_t ended = scene.start.solve(context, solver).summary().termination;
        if (ended != CLBA_CONVERGENCE) std::printf("scene %d did not converge\n", seed);
        clba::CovarianceOptions options;
        options.all_points = 1;
        const clba::Images truth = scene.truth.images();
        // The gauge is that of the state to compare with; the images are chosen at it.
        const clba::CovarianceInfo chosen = scene.start.covariance(context, options).info();
        options.gauge = CLBA_GAUGE_FIRST_IMAGE_AND_BASELINE;
        std::copy_n(chosen.gauge_images, 2, options.gauge_images);
        clba::GaugeTarget target;
        std::copy_n(options.gauge_images, 2, target.images);
        const auto& first = truth.poses[static_cast<size_t>(options.gauge_images[0])];
        const auto& second = truth.poses[static_cast<size_t>(options.gauge_images[1])];
        target.pose = first.data();
        target.baseline = (center_of(second) - center_of(first)).norm();
        scene.start.fix_gauge(target);
        const clba::Covariance covariance = scene.start.covariance(context, options);

        const clba::Images found = scene.start.images();
        const clba::Cameras cameras = scene.start.cameras(), true_cameras = scene.truth.cameras();
        for (size_t i = 0; i < found.poses.size(); ++i) {
            const auto row = static_cast<int64_t>(i);
            // found = exp(w) truth, and v = -R dC, to first order.
            const Matrix3d rotation = rotation_of(found.poses[i]);
            const Eigen::AngleAxisd turn(
                Matrix3d(rotation * rotation_of(truth.poses[i]).transpose()));
            const Eigen::Vector3d moved = center_of(found.poses[i]) - center_of(truth.poses[i]);
            VectorXd error(6);
            error << turn.angle() * turn.axis(), -rotation * moved;
            poses.add(error, Eigen::Map<const RowMajor>(covariance.pose(row).data(), 6, 6));
            centers.add(moved, Eigen::Map<const RowMajor>(covariance.center(row).data(), 3, 3));
            const Eigen::Map<const VectorXd> params(cameras.params.data() + 3 * i, 3);
            const Eigen::Map<const VectorXd> true_params(true_cameras.params.data() + 3 * i, 3);
            const std::vector<double> block = covariance.block(CLBA_BLOCK_INTRINSICS, row, 3);
            intrinsics.add(params - true_params, Eigen::Map<const RowMajor>(block.data(), 3, 3));
        }
        const auto xyz = scene.start.points(), true_xyz = scene.truth.points();
        for (size_t p = 0; p < xyz.size(); ++p) {
            const auto block = covariance.point(static_cast<int64_t>(p));
            if (!std::isfinite(block[0])) continue;
            points.add(Eigen::Vector3d(xyz[p].data()) - Eigen::Vector3d(true_xyz[p].data()),
                       Eigen::Map<const RowMajor>(block.data(), 3, 3));
        }
    }
    for (const Share* share : {&poses, &centers, &intrinsics, &points}) share->print();
}

clba::Problem truth_of(const std::string& name, int32_t num_images) {
    clba::SceneOptions options;
    options.scene = scene_of(name);
    options.num_images = num_images;
    return std::move(clba::generate(options).truth);
}

void print(const clba::CovarianceInfo& info, const clba::Problem& problem) {
    std::printf(
        "%d images, %d points, %lld observations, %s, gauge %s: %.2f s (S %.2f, factor "
        "%.2f, inverse %.2f, points %.2f), %.0f MB for S, its factor and inverse, peak of "
        "the process %.0f MB, points without parallax %lld",
        info.num_images, problem.info().num_points,
        static_cast<long long>(problem.info().num_observations),
        std::string(clba::covariance_method_name(info.method)).c_str(),
        std::string(clba::covariance_gauge_name(info.gauge)).c_str(), info.total_seconds,
        info.form_seconds, info.factor_seconds, info.inverse_seconds, info.point_seconds,
        1e-6 * static_cast<double>(info.bytes), 1e-6 * static_cast<double>(peak_memory()),
        static_cast<long long>(info.num_undetermined_points));
    if (info.num_samples > 0)
        std::printf(", %d samples of %.0f iterations", info.num_samples,
                    static_cast<double>(info.num_linear_solver_iterations) / info.num_samples);
    std::printf("\n");
}

void time_exact(const std::string& scene, int32_t num_images) {
    const clba::Context context;
    clba::Problem problem = truth_of(scene, num_images);
    clba::CovarianceOptions options;
    options.method = CLBA_COVARIANCE_EXACT;
    options.all_points = 1;
    problem.covariance(context, options);  // compiles kernels
    print(problem.covariance(context, options).info(), problem);
}

void time_sampled(const std::string& scene, int32_t num_images, int32_t num_samples) {
    const clba::Context context;
    clba::Problem problem = truth_of(scene, num_images);
    clba::CovarianceOptions options;
    const clba::Covariance exact = problem.covariance(context, options);
    options.method = CLBA_COVARIANCE_SAMPLED;
    options.num_samples = num_samples;
    int64_t num = 0, num_inside = 0;
    double squares = 0;
    // Errors of one run are alike, as its images share them: several runs.
    for (options.seed = 0; options.seed < 10; ++options.seed) {
        const clba::Covariance sampled = problem.covariance(context, options);
        if (options.seed == 0) print(sampled.info(), problem);
        for (int32_t i = 0; i < exact.info().num_images; ++i) {
            const auto truth = exact.center(i), estimate = sampled.center(i);
            const std::vector<double> errors = sampled.standard_errors(CLBA_BLOCK_CENTER, i, 3);
            for (size_t k = 0; k < 9; k += 4) {
                if (!(truth[k] > 0)) continue;
                const double ratio = (estimate[k] - truth[k]) / errors[k];
                ++num;
                num_inside += std::abs(ratio) < 2 ? 1 : 0;
                squares += ratio * ratio;
            }
        }
    }
    std::printf(
        "variances of centres within two standard errors of the exact ones: %.1f %% of "
        "%lld; mean square of the ratio %.2f\n",
        100 * static_cast<double>(num_inside) / static_cast<double>(num),
        static_cast<long long>(num), squares / static_cast<double>(num));
}

}  // namespace

int main(int argc, char** argv) try {
    const std::string what = argc > 1 ? argv[1] : "";
    if (what == "statistics" && argc == 3)
        statistics(std::atoi(argv[2]));
    else if (what == "time" && argc == 4)
        time_exact(argv[2], std::atoi(argv[3]));
    else if (what == "sampled" && argc == 5)
        time_sampled(argv[2], std::atoi(argv[3]), std::atoi(argv[4]));
    else
        throw std::invalid_argument("see the top of bench/covariance.cpp for its arguments");
    return EXIT_SUCCESS;
} catch (const std::exception& error) {
    std::fprintf(stderr, "covariance: %s\n", error.what());
    return EXIT_FAILURE;
}
