// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "cli/commands.hpp"
#include "cli/covariance.hpp"
#include "cli/files.hpp"
#include "cli/filter.hpp"
#include "cli/handles.hpp"
#include "cli/interrupt.hpp"
#include "cli/options.hpp"
#include "cli/outputs.hpp"
#include "cli/priors.hpp"
#include "cli/solver_run.hpp"
#include "cli/verify.hpp"

namespace cli {
namespace {

using Json = nlohmann::ordered_json;

struct SolveArguments {
    SolveArguments() { check(clba_solver_options_init(&options, sizeof options)); }
    clba_solver_options options = {};
    std::string file;
    Output output;
    std::string ply;
    std::string json;
    std::string position_priors;
    std::string point_priors;
    double pixel_sigma = 0;  // 0: those of the file
    bool align_to_priors = false;
    std::string device;
    CovarianceArguments covariance;
    std::string checkpoint;
    std::string resume;
    int32_t loss = CLBA_LOSS_NONE;
    double loss_scale = 1;
    clba_filter_options filter = filter_defaults();
    int32_t filter_rounds = 0;
    std::vector<std::string> constant_intrinsics;  // names, or "all"
    bool constant_sensors = false;
    bool verify = false;
    bool quiet = false;
};

Context make_context(const std::string& device) {
    clba_context_options options = {};
    check(clba_context_options_init(&options, sizeof options));
    if (!device.empty()) options.device = device.c_str();
    clba_context* context = nullptr;
    check(clba_context_create(&options, &context));
    return Context(context);
}

// The rigs of the file with all sensors constant.
void hold_sensors(clba_problem* problem) {
    const clba_problem_info info = info_of(problem);
    if (info.num_frames == 0) return;
    const auto num_images = static_cast<size_t>(info.num_images);
    std::vector<int32_t> frames(num_images), sensors(num_images);
    std::vector<double> sensor_poses(7 * static_cast<size_t>(info.num_sensors));
    std::vector<double> frame_poses(7 * static_cast<size_t>(info.num_frames));
    const std::vector<int32_t> constant(static_cast<size_t>(info.num_sensors), CLBA_CONSTANT_POSE);
    check(clba_problem_get_image_rigs(problem, 0, info.num_images, frames.data(), 0, sensors.data(),
                                      0));
    check(
        clba_problem_get_sensors(problem, 0, info.num_sensors, sensor_poses.data(), 0, nullptr, 0));
    check(clba_problem_get_frames(problem, 0, info.num_frames, frame_poses.data(), 0, nullptr, 0));
    clba_rigs rigs = {};
    check(clba_rigs_init(&rigs, sizeof rigs));
    rigs.num_frames = info.num_frames;
    rigs.num_sensors = info.num_sensors;
    rigs.frames = frames.data();
    rigs.sensors = sensors.data();
    rigs.sensor_poses = sensor_poses.data();
    rigs.frame_poses = frame_poses.data();
    rigs.constant_sensors = constant.data();
    check(clba_problem_set_rigs(problem, &rigs));
}

// Beside the parameters that the file's cameras do not have.
void hold_intrinsics(clba_problem* problem, const std::vector<std::string>& names) {
    const auto num_cameras = static_cast<size_t>(info_of(problem).num_cameras);
    const auto count = static_cast<int32_t>(num_cameras);
    std::vector<int32_t> models(num_cameras), flags(num_cameras);
    check(clba_problem_get_cameras(problem, 0, count, models.data(), 0, nullptr, 0));
    check(clba_problem_get_constant_cameras(problem, 0, count, flags.data(), 0));
    for (const std::string& name : names) {
        bool is_known = false;
        for (size_t i = 0; i < num_cameras; ++i) {
            std::istringstream params(clba_camera_model_param_names(models[i]));
            std::string param;
            for (int k = 0; std::getline(params, param, ','); ++k) {
                if (name != "all" && name != param) continue;
                flags[i] |= 1 << k;
                is_known = true;
            }
        }
        if (!is_known && num_cameras > 0)
            throw Failure(ExitCode::usage,
                          "--constant-intrinsics: no camera has a parameter " + name +
                              "; name those of a model, as f,cx,cy of simple_pinhole, or all");
    }
    check(clba_problem_set_constant_cameras(problem, count, flags.data(), 0));
}

Problem read_start(const SolveArguments& arguments, bool quiet) {
    Problem problem = read_problem(arguments.file, quiet);
    if (info_of(problem.get()).num_observations == 0)
        throw Failure(ExitCode::file, arguments.file + ": has no observations; nothing to solve");
    check(clba_problem_set_loss(problem.get(), arguments.loss, arguments.loss_scale));
    if (!arguments.constant_intrinsics.empty())
        hold_intrinsics(problem.get(), arguments.constant_intrinsics);
    if (arguments.constant_sensors) hold_sensors(problem.get());
    if (arguments.pixel_sigma > 0) {
        const std::vector<double> sigmas(
            static_cast<size_t>(info_of(problem.get()).num_observations), arguments.pixel_sigma);
        check(clba_problem_set_sigmas(problem.get(), info_of(problem.get()).num_observations,
                                      sigmas.data(), 0));
    }
    if (!arguments.position_priors.empty())
        read_position_priors(arguments.position_priors, problem.get(), arguments.align_to_priors,
                             quiet);
    if (!arguments.point_priors.empty()) read_point_priors(arguments.point_priors, problem.get());
    return problem;
}

void write_states(const clba_problem* problem, const SolveArguments& arguments) {
    if (!arguments.output.path.empty()) write_problem(problem, arguments.output);
    if (!arguments.ply.empty()) check(clba_problem_write_ply(problem, arguments.ply.c_str()));
}

// Of |r| without the loss, pixels.
double median_residual(clba_problem* problem, clba_context* context, int32_t precision) {
    const auto num_observations = static_cast<size_t>(info_of(problem).num_observations);
    std::vector<double> residuals(2 * num_observations);
    clba_evaluation evaluation = {};
    check(clba_evaluation_init(&evaluation, sizeof evaluation));
    evaluation.precision = precision;  // the one whose kernels are built
    evaluation.apply_loss = 0;
    evaluation.residuals = residuals.data();
    check(clba_problem_evaluate(problem, context, &evaluation));
    std::vector<double> norms(num_observations);
    for (size_t i = 0; i < num_observations; ++i)
        norms[i] = std::hypot(residuals[2 * i], residuals[2 * i + 1]);
    const auto middle = norms.begin() + static_cast<std::ptrdiff_t>(num_observations / 2);
    std::nth_element(norms.begin(), middle, norms.end());
    return *middle;
}

Json summary_json(const SolveArguments& arguments, const clba_problem* problem,
                  const clba_result* result, double median) {
    const clba_problem_info info = info_of(problem);
    Json json = {
        {"file", arguments.file},
        {"images", info.num_images},
        {"points", info.num_points},
        {"observations", info.num_observations},
        {"loss", clba_loss_name(arguments.loss)},
        {"loss_scale", arguments.loss_scale},
        {"median_residual", median},
    };
    json.update(Json::parse(clba_result_json(result)));
    return json;
}

void write_json(const std::string& path, const Json& json) {
    // File names need not be UTF-8; what is not is replaced.
    if (!path.empty())
        write_text(path, json.dump(2, ' ', false, Json::error_handler_t::replace) + '\n');
}

// Solves; then, for as many rounds as are wanted and find outliers, removes these and solves again.
Result solve_in_rounds(clba_problem* problem, clba_context* context,
                       const SolveArguments& arguments, Json& filtered) {
    Result result = run_solver(problem, context, arguments.options, arguments.quiet);
    for (int32_t round = 0; round < arguments.filter_rounds; ++round) {
        if (summary_of(result.get()).termination == CLBA_FAILURE || interrupted()) break;
        const clba_filter_report report = filter(problem, arguments.filter);
        filtered.push_back(filter_json(report));
        if (!arguments.quiet) {
            std::printf("\n");
            print_filter_report(report);
            std::printf("\n");
        }
        if (report.num_observations_removed == 0) break;
        if (info_of(problem).num_observations == 0)
            throw Failure(ExitCode::usage, "the filter removed all observations; let it keep more");
        result = run_solver(problem, context, arguments.options, arguments.quiet);
    }
    return result;
}

ExitCode exit_code_of(const clba_summary& summary) {
    if (summary.termination == CLBA_FAILURE) return ExitCode::not_solved;
    return interrupted() ? ExitCode::interrupted : ExitCode::ok;
}

ExitCode solve(SolveArguments& arguments) {
    const bool goes_on = arguments.checkpoint == arguments.resume;  // in the same file
    check_outputs(
        {arguments.output.path,
         {arguments.ply, arguments.json, arguments.covariance.file, arguments.checkpoint}},
        arguments.file,
        {arguments.position_priors, arguments.point_priors, goes_on ? "" : arguments.resume});
    if (!arguments.checkpoint.empty())
        arguments.options.checkpoint_path = arguments.checkpoint.c_str();
    if (!arguments.resume.empty()) arguments.options.resume_path = arguments.resume.c_str();
    const Context context = make_context(arguments.device);
    const Problem problem = read_start(arguments, arguments.quiet);
    if (!arguments.output.path.empty()) check_write(problem.get(), arguments.output);
    // Read now, because the output may replace the file.
    const Problem start = arguments.verify ? read_start(arguments, true) : nullptr;

    Json filtered = Json::array();
    const Result result = solve_in_rounds(problem.get(), context.get(), arguments, filtered);
    write_states(problem.get(), arguments);
    const double median =
        median_residual(problem.get(), context.get(), summary_of(result.get()).precision);
    Json json = summary_json(arguments, problem.get(), result.get(), median);
    if (arguments.filter_rounds > 0) json["filter"] = filtered;
    write_json(arguments.json, json);
    if (!arguments.quiet)
        std::printf("\n%sMedian residual              %.4g pixels\n",
                    clba_result_report(result.get()), median);

    const clba_summary summary = summary_of(result.get());
    if (summary.checkpoint_error[0])
        std::fprintf(stderr, "clba: warning: a checkpoint is missing: %s\n",
                     summary.checkpoint_error);
    if (exit_code_of(summary) == ExitCode::not_solved)
        std::fprintf(stderr, "clba: error: %s: not solved: %s\n", arguments.file.c_str(),
                     summary.message);
    if (!arguments.covariance.file.empty()) {
        if (exit_code_of(summary) == ExitCode::ok)
            write_covariances(problem.get(), context.get(), arguments.covariance, arguments.quiet);
        else
            std::fprintf(stderr, "clba: %s: no covariances are written of what is not solved\n",
                         arguments.covariance.file.c_str());
    }
    if (arguments.verify && exit_code_of(summary) == ExitCode::ok) {
        json["verify"] = verify(problem.get(), summary, start.get(), context.get(),
                                arguments.options, arguments.quiet);
        write_json(arguments.json, json);
    }
    return exit_code_of(summary);
}

void add_output_options(CLI::App& command, SolveArguments& arguments) {
    command
        .add_option("-o,--output", arguments.output.path,
                    "the solution: a file or folder in the format of FILE, unless its ending or "
                    "--output-format says otherwise")
        ->check(not_empty);
    add_output_format(command, "--output-format", arguments.output);
    command.add_option("--ply", arguments.ply, "PLY file of points and camera centres")
        ->check(not_empty);
    command.add_option("--json", arguments.json, "JSON file of the summary and every iteration")
        ->check(not_empty);
    command.add_flag("--verify", arguments.verify,
                     "solve again by direct_schur in double precision and compare");
    command.add_flag("--quiet", arguments.quiet, "print errors only");
}

void add_priors(CLI::App& command, SolveArguments& arguments) {
    CLI::Option* positions =
        command
            .add_option("--position-priors", arguments.position_priors,
                        "CSV file of camera centres, as by GPS: image, x, y, z, sx, sy, sz with "
                        "the image's name or index and standard deviations, in the world's units")
            ->check(not_empty);
    command
        .add_flag("--align-to-priors", arguments.align_to_priors,
                  "first move the problem, as a similarity, to where its centres fit "
                  "--position-priors best")
        ->needs(positions);
    command
        .add_option("--point-priors", arguments.point_priors,
                    "CSV file of points, as of ground control: point, x, y, z, sx, sy, sz")
        ->check(not_empty);
    command
        .add_option("--pixel-sigma", arguments.pixel_sigma,
                    "standard deviation of all observations, pixels: their weight against "
                    "priors'; 1")
        ->check(positive_number);
}

void add_solver_options(CLI::App& command, SolveArguments& arguments) {
    clba_solver_options& options = arguments.options;
    command.add_option("--device", arguments.device,
                       "index, or part of the platform's or device's name; default: environment "
                       "CLBA_DEVICE, else the best found");
    add_choice(command, "--linear-solver", options.linear_solver, clba_linear_solver_name,
               "how the step is computed");
    add_choice(command, "--preconditioner", options.preconditioner, clba_preconditioner_name,
               "of the conjugate gradients");
    add_choice(command, "--precision", options.precision, clba_precision_name,
               "mixed: fp32 matrix products, all else in fp64; single: no fp64 at all; auto: mixed "
               "where the device has fp64, else single");
    add_choice(command, "--jacobian", options.jacobian, clba_jacobian_name,
               "what the device keeps of the Jacobian");
    add_choice(command, "--damping", options.damping, clba_damping_name,
               "diagonal that the damping multiplies");
    CLI::Option* loss =
        add_choice(command, "--loss", arguments.loss, clba_loss_name, "robust loss");
    command.add_option("--loss-scale", arguments.loss_scale, "where the loss sets in, pixels")
        ->needs(loss)
        ->check(positive_number)
        ->capture_default_str();
    command
        .add_option("--constant-intrinsics", arguments.constant_intrinsics,
                    "names of camera parameters to hold, as cx,cy for the principal points that "
                    "COLMAP's bundle adjustment holds; or all")
        ->delimiter(',')
        ->check(not_empty);
    command.add_flag("--constant-sensors", arguments.constant_sensors,
                     "hold the cameras of rigs in their places on them");
}

void add_limits(CLI::App& command, clba_solver_options& options) {
    command.add_option("--max-iterations", options.max_num_iterations, "limit on iterations")
        ->check(non_negative_number)
        ->capture_default_str();
    command
        .add_option("--max-linear-solver-iterations", options.max_linear_solver_iterations,
                    "limit on iterations of the conjugate gradients in a step")
        ->check(positive_number)
        ->capture_default_str();
    command.add_option("--time-limit", options.max_seconds, "limit on seconds of the solve")
        ->check(positive_number);
    command
        .add_option("--target-cost", options.target_cost, "end if the cost is not above this; 0")
        ->check(non_negative_number);
    command
        .add_option("--eta", options.eta,
                    "forcing term of the inexact step, below 1; 0: by the preconditioner")
        ->capture_default_str();
    command
        .add_option("--function-tolerance", options.function_tolerance,
                    "end if the cost changes by less, relatively")
        ->capture_default_str();
    command
        .add_option("--gradient-tolerance", options.gradient_tolerance,
                    "end if no entry of the gradient is larger")
        ->capture_default_str();
    command
        .add_option("--parameter-tolerance", options.parameter_tolerance,
                    "end if the step is shorter, relatively")
        ->capture_default_str();
    command
        .add_option("--initial-radius", options.initial_trust_region_radius,
                    "1 / lambda of the first step")
        ->check(positive_number)
        ->capture_default_str();
}

void add_checkpoints(CLI::App& command, SolveArguments& arguments) {
    command
        .add_option("--checkpoint", arguments.checkpoint,
                    "file from which the solve can go on later, by --resume")
        ->check(not_empty);
    command
        .add_option(
            "--checkpoint-every", arguments.options.checkpoint_every,
            "iterations between checkpoints; 0: only where a limit or Ctrl-C ends the solve")
        ->check(non_negative_number)
        ->capture_default_str();
    command
        .add_option("--resume", arguments.resume,
                    "go on from a checkpoint of the same problem and options")
        ->check(not_empty);
}

void add_filter_rounds(CLI::App& command, SolveArguments& arguments) {
    CLI::Option* rounds = command
                              .add_option("--filter-rounds", arguments.filter_rounds,
                                          "how often at most to remove outliers and solve again")
                              ->check(non_negative_number)
                              ->capture_default_str();
    for (const char* other : {"--verify", "--checkpoint", "--resume"})
        rounds->excludes(command.get_option(other));
    add_filter_options(command, arguments.filter, "filter-");
}

}  // namespace

void add_solve(CLI::App& program, int& result) {
    CLI::App* command = program.add_subcommand("solve", "Refine a problem");
    command->footer(exit_code_help);
    const auto arguments = std::make_shared<SolveArguments>();
    command->add_option("FILE", arguments->file, problem_help)->required();
    add_output_options(*command, *arguments);
    add_covariance_options(*command, arguments->covariance);
    add_priors(*command, *arguments);
    add_solver_options(*command, *arguments);
    add_limits(*command, arguments->options);
    add_checkpoints(*command, *arguments);
    add_filter_rounds(*command, *arguments);
    command->callback([arguments, &result] { result = static_cast<int>(solve(*arguments)); });
}

}  // namespace cli
