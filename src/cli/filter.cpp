// SPDX-License-Identifier: Apache-2.0
#include "cli/filter.hpp"

#include <cstdio>
#include <memory>

#include "cli/commands.hpp"
#include "cli/files.hpp"
#include "cli/options.hpp"
#include "cli/outputs.hpp"

namespace cli {
namespace {

struct FilterArguments {
    clba_filter_options options = filter_defaults();
    std::string input;
    Output output;
    std::string json;
    bool keep_points = false;
    bool quiet = false;
};

void filter_file(FilterArguments& arguments) {
    check_outputs({arguments.output.path, {arguments.json}}, arguments.input);
    const Problem problem = read_problem(arguments.input, arguments.quiet);
    check_write(problem.get(), arguments.output);
    arguments.options.remove_points = !arguments.keep_points;
    const clba_filter_report report = filter(problem.get(), arguments.options);
    write_problem(problem.get(), arguments.output);
    if (!arguments.json.empty()) write_text(arguments.json, filter_json(report).dump(2) + '\n');
    if (!arguments.quiet) print_filter_report(report);
}

}  // namespace

clba_filter_options filter_defaults() {
    clba_filter_options options = {};
    check(clba_filter_options_init(&options, sizeof options));
    return options;
}

void add_filter_options(CLI::App& command, clba_filter_options& options,
                        const std::string& prefix) {
    command
        .add_option("--" + prefix + "max-error", options.max_reprojection_error,
                    "remove observations with a larger reprojection error, pixels")
        ->check(positive_number)
        ->capture_default_str();
    command
        .add_option("--" + prefix + "min-angle", options.min_triangulation_angle,
                    "remove points whose rays all meet under a smaller angle, degrees")
        ->check(non_negative_number)
        ->capture_default_str();
    command
        .add_option("--" + prefix + "min-views", options.min_num_views,
                    "remove points that fewer images see")
        ->check(non_negative_number)
        ->capture_default_str();
    command.add_flag_callback(
        "--" + prefix + "keep-behind", [&options] { options.remove_behind = 0; },
        "keep observations of points behind their camera");
}

clba_filter_report filter(clba_problem* problem, const clba_filter_options& options) {
    clba_filter_report report = {};
    report.struct_size = sizeof report;
    check(clba_problem_filter(problem, &options, &report));
    return report;
}

void print_filter_report(const clba_filter_report& report) {
    const auto print = [](const char* label, int64_t number) {
        std::printf("%-28s %lld\n", label, static_cast<long long>(number));
    };
    print("Observations removed", report.num_observations_removed);
    print("  behind their camera", report.num_behind);
    print("  of a large error", report.num_large_error);
    print("  of points in few views", report.num_few_views);
    print("  of points of small angle", report.num_small_angle);
    print("Points that lost all", report.num_points_unobserved);
    print("Points removed", report.num_points_removed);
    print("Images that lost all", report.num_images_unobserved);
}

nlohmann::ordered_json filter_json(const clba_filter_report& report) {
    return {
        {"num_observations_removed", report.num_observations_removed},
        {"num_behind", report.num_behind},
        {"num_large_error", report.num_large_error},
        {"num_few_views", report.num_few_views},
        {"num_small_angle", report.num_small_angle},
        {"num_points_few_views", report.num_points_few_views},
        {"num_points_small_angle", report.num_points_small_angle},
        {"num_points_unobserved", report.num_points_unobserved},
        {"num_points_removed", report.num_points_removed},
        {"num_images_unobserved", report.num_images_unobserved},
    };
}

void add_filter(CLI::App& program) {
    CLI::App* command = program.add_subcommand("filter", "Remove outliers; needs no device");
    const auto arguments = std::make_shared<FilterArguments>();
    command->add_option("IN", arguments->input, problem_help)->required();
    command
        ->add_option(
            "OUT", arguments->output.path,
            "file or folder of what is left, in the format that convert would give; may be IN")
        ->check(not_empty)
        ->required();
    add_output_format(*command, "--format", arguments->output);
    add_filter_options(*command, arguments->options, "");
    command->add_flag("--keep-points", arguments->keep_points,
                      "keep points that are left without observations");
    command->add_option("--json", arguments->json, "JSON file of what was removed")
        ->check(not_empty);
    command->add_flag("--quiet", arguments->quiet, "print errors only");
    command->callback([arguments] { filter_file(*arguments); });
}

}  // namespace cli
