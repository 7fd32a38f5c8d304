// SPDX-License-Identifier: Apache-2.0
// Solves one BAL problem by Ceres and prints what happened as lines of JSON, for bench/peers.py:
//   {"event":"loaded", ...}    the arrays are in host memory; the clock starts here
//   {"event":"row", ...}       one an iteration, as it ends: seconds by the clock, cost kept
//   {"event":"summary", ...}
#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "clba/clba.h"
#include "peers_memory.h"

namespace {

constexpr int num_camera_parameters = 9;  // angle-axis, translation, f, k1, k2

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

struct Arrays {
    std::vector<double> cameras, points, xy;
    std::vector<int32_t> image_indices, point_indices;
};

void check(clba_status status) {
    if (status == CLBA_OK) return;
    std::fprintf(stderr, "peers_ceres: %s\n", clba_last_error());
    std::exit(2);
}

Arrays read(const char* path) {
    clba_problem* problem = nullptr;
    check(clba_problem_read_bal(path, &problem));
    clba_problem_info info;
    info.struct_size = sizeof info;
    check(clba_problem_get_info(problem, &info));
    const auto num_images = static_cast<std::size_t>(info.num_images);
    const auto num_points = static_cast<std::size_t>(info.num_points);
    const auto num_observations = static_cast<std::size_t>(info.num_observations);

    std::vector<double> poses(7 * num_images), intrinsics(3 * num_images);
    std::vector<int32_t> camera_indices(num_images), models(num_images);
    Arrays arrays;
    arrays.points.resize(3 * num_points);
    arrays.xy.resize(2 * num_observations);
    arrays.image_indices.resize(num_observations);
    arrays.point_indices.resize(num_observations);
    check(clba_problem_get_images(problem, 0, info.num_images, camera_indices.data(), 0,
                                  poses.data(), 0));
    check(clba_problem_get_cameras(problem, 0, info.num_cameras, models.data(), 0,
                                   intrinsics.data(), 0));
    check(clba_problem_get_points(problem, 0, info.num_points, arrays.points.data(), 0));
    check(clba_problem_get_observations(problem, 0, info.num_observations,
                                        arrays.image_indices.data(), 0, arrays.point_indices.data(),
                                        0, arrays.xy.data(), 0));
    clba_problem_release(problem);

    arrays.cameras.resize(num_camera_parameters * num_images);
    for (std::size_t image = 0; image < num_images; ++image) {
        double* camera = &arrays.cameras[num_camera_parameters * image];
        ceres::QuaternionToAngleAxis(&poses[7 * image], camera);
        std::copy_n(&poses[7 * image + 4], 3, camera + 3);
        std::copy_n(&intrinsics[3 * static_cast<std::size_t>(camera_indices[image])], 3,
                    camera + 6);
    }
    return arrays;
}

// Snavely's camera, which looks along -z; points behind it keep the formula's value.
struct ReprojectionError {
    double x, y;
    template <typename T>
    bool operator()(const T* camera, const T* point, T* residual) const {
        T p[3];
        ceres::AngleAxisRotatePoint(camera, point, p);
        for (int i = 0; i < 3; ++i) p[i] += camera[3 + i];
        const T u = -p[0] / p[2];
        const T v = -p[1] / p[2];
        const T r2 = u * u + v * v;
        const T scale = camera[6] * (1.0 + r2 * (camera[7] + r2 * camera[8]));
        residual[0] = scale * u - x;
        residual[1] = scale * v - y;
        return true;
    }
};

struct Arguments {
    std::string file;
    ceres::Solver::Options options;
};

[[noreturn]] void fail_usage(const std::string& what) {
    std::fprintf(
        stderr,
        "peers_ceres: %s\n"
        "usage: peers_ceres FILE [--linear-solver dense_schur|sparse_schur|iterative_schur]\n"
        "  [--preconditioner jacobi|schur_jacobi|cluster_jacobi] [--dense-library eigen|lapack]\n"
        "  [--threads N] [--max-iterations M] [--max-seconds S]\n",
        what.c_str());
    std::exit(2);
}

std::string in_capitals(std::string text) {
    for (char& c : text)
        if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 'a' + 'A');
    return text;
}

Arguments parse(int argc, char** argv) {
    Arguments arguments;
    ceres::Solver::Options& options = arguments.options;
    options.linear_solver_type = ceres::SPARSE_SCHUR;
    options.max_num_iterations = 100;
    for (int i = 1; i < argc; ++i) {
        const std::string name = argv[i];
        if (name.rfind("--", 0) != 0) {
            arguments.file = name;
            continue;
        }
        if (i + 1 == argc) fail_usage(name + " needs a value");
        const std::string value = argv[++i];
        bool known = true;
        if (name == "--linear-solver")
            known =
                ceres::StringToLinearSolverType(in_capitals(value), &options.linear_solver_type);
        else if (name == "--preconditioner")
            known =
                ceres::StringToPreconditionerType(in_capitals(value), &options.preconditioner_type);
        else if (name == "--dense-library")
            known = ceres::StringToDenseLinearAlgebraLibraryType(
                in_capitals(value), &options.dense_linear_algebra_library_type);
        else if (name == "--threads")
            options.num_threads = std::atoi(value.c_str());
        else if (name == "--max-iterations")
            options.max_num_iterations = std::atoi(value.c_str());
        else if (name == "--max-seconds")
            options.max_solver_time_in_seconds = std::atof(value.c_str());
        else
            fail_usage("unknown option " + name);
        if (!known) fail_usage(name + " has no value " + value);
    }
    if (arguments.file.empty()) fail_usage("no file");
    return arguments;
}

class PrintRow : public ceres::IterationCallback {
public:
    explicit PrintRow(Clock::time_point start) : start_(start) {}
    ceres::CallbackReturnType operator()(const ceres::IterationSummary& row) override {
        if (row.step_is_successful || row.iteration == 0) cost_ = row.cost;
        std::printf(
            "{\"event\":\"row\",\"iteration\":%d,\"seconds\":%.6f,\"cost\":%.17g,"
            "\"accepted\":%d,\"linear_solver_iterations\":%d,"
            "\"linear_solver_seconds\":%.6f,\"trust_region_radius\":%.6g}\n",
            row.iteration, seconds_since(start_), cost_, row.step_is_successful,
            row.linear_solver_iterations, row.step_solver_time_in_seconds, row.trust_region_radius);
        std::fflush(stdout);
        return ceres::SOLVER_CONTINUE;
    }

private:
    Clock::time_point start_;
    double cost_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
    google::InitGoogleLogging(argv[0]);
    Arguments arguments = parse(argc, argv);
    const auto read_start = Clock::now();
    Arrays arrays = read(arguments.file.c_str());
    peers_reset_peak_memory();
    std::printf(
        "{\"event\":\"loaded\",\"read_seconds\":%.3f,\"images\":%zu,\"points\":%zu,"
        "\"observations\":%zu,\"start_bytes\":%llu,\"version\":\"%s\"}\n",
        seconds_since(read_start), arrays.cameras.size() / num_camera_parameters,
        arrays.points.size() / 3, arrays.image_indices.size(), peers_peak_memory(),
        CERES_VERSION_STRING);
    std::fflush(stdout);

    const auto start = Clock::now();
    ceres::Problem::Options problem_options;
    // Nothing is removed from the problem or moved between blocks, so the checks are not needed.
    problem_options.disable_all_safety_checks = true;
    ceres::Problem problem(problem_options);
    for (std::size_t i = 0; i < arrays.image_indices.size(); ++i) {
        auto* error = new ReprojectionError{arrays.xy[2 * i], arrays.xy[2 * i + 1]};
        const auto image = static_cast<std::size_t>(arrays.image_indices[i]);
        const auto point = static_cast<std::size_t>(arrays.point_indices[i]);
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<ReprojectionError, 2, num_camera_parameters, 3>(error),
            nullptr, &arrays.cameras[num_camera_parameters * image], &arrays.points[3 * point]);
    }
    auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    std::vector<double*> blocks;
    problem.GetParameterBlocks(&blocks);
    const double* first_point = arrays.points.data();
    const double* last_point = first_point + arrays.points.size();
    for (double* block : blocks)
        ordering->AddElementToGroup(block, block >= first_point && block < last_point ? 0 : 1);
    const double build_seconds = seconds_since(start);

    ceres::Solver::Options& options = arguments.options;
    options.linear_solver_ordering = ordering;
    options.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
    options.initial_trust_region_radius = 1e4;
    options.jacobi_scaling = true;
    options.use_explicit_schur_complement = false;
    options.eta = 0.1;
    options.max_linear_solver_iterations = 500;
    options.function_tolerance = 1e-9;
    options.gradient_tolerance = 1e-10;
    options.parameter_tolerance = 1e-10;
    options.max_solver_time_in_seconds =
        std::max(0.0, options.max_solver_time_in_seconds - build_seconds);
    options.logging_type = ceres::SILENT;
    PrintRow print_row(start);
    options.callbacks.push_back(&print_row);
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    const double total_seconds = seconds_since(start);

    std::printf(
        "{\"event\":\"summary\",\"initial_cost\":%.17g,\"final_cost\":%.17g,"
        "\"total_seconds\":%.6f,\"create_seconds\":%.6f,\"preprocessor_seconds\":%.6f,"
        "\"linear_solver_seconds\":%.6f,\"jacobian_seconds\":%.6f,"
        "\"residual_seconds\":%.6f,\"usable\":%d,\"termination\":\"%s\","
        "\"preconditioner_used\":\"%s\",\"peak_bytes\":%llu}\n",
        summary.initial_cost, summary.final_cost, total_seconds, build_seconds,
        summary.preprocessor_time_in_seconds, summary.linear_solver_time_in_seconds,
        summary.jacobian_evaluation_time_in_seconds, summary.residual_evaluation_time_in_seconds,
        summary.IsSolutionUsable(), ceres::TerminationTypeToString(summary.termination_type),
        ceres::PreconditionerTypeToString(summary.preconditioner_type_used), peers_peak_memory());
    return 0;
}
