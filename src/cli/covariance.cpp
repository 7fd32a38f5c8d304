// SPDX-License-Identifier: Apache-2.0
#include "cli/covariance.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <vector>

#include "cli/handles.hpp"
#include "cli/options.hpp"
#include "cli/outputs.hpp"

namespace cli {
namespace {

using Json = nlohmann::ordered_json;

// Blocks of one kind: the lower triangle of each, row by row.
struct Blocks {
    const char* name;
    int32_t block;
    std::vector<size_t> sizes;
};

std::vector<Blocks> list_blocks(const clba_problem* problem, const clba_covariance_info& info) {
    const auto num_images = static_cast<size_t>(info.num_images);
    std::vector<int32_t> models(static_cast<size_t>(info.num_cameras));
    check(clba_problem_get_cameras(problem, 0, info.num_cameras, models.data(), 0, nullptr, 0));
    std::vector<size_t> num_params;
    for (const int32_t model : models)
        num_params.push_back(static_cast<size_t>(clba_camera_model_num_params(model)));
    return {
        {"pose", CLBA_BLOCK_POSE, std::vector<size_t>(num_images, 6)},
        {"center", CLBA_BLOCK_CENTER, std::vector<size_t>(num_images, 3)},
        {"intrinsics", CLBA_BLOCK_INTRINSICS, num_params},
        {"point", CLBA_BLOCK_POINT, std::vector<size_t>(static_cast<size_t>(info.num_points), 3)}};
}

// visit(value, standard error, row, column) for the lower triangle.
template <class Visit>
void for_each_entry(const clba_covariance* covariance, int32_t block, size_t row, size_t size,
                    const Visit& visit) {
    std::vector<double> values(size * size), errors(size * size);
    check(clba_covariance_get(covariance, block, static_cast<int64_t>(row), 1, values.data(),
                              errors.data(), 0));
    for (size_t i = 0; i < size; ++i)
        for (size_t j = 0; j <= i; ++j) visit(values[i * size + j], errors[i * size + j], i, j);
}

std::string csv_text(const clba_covariance* covariance, const clba_covariance_info& info,
                     const std::vector<Blocks>& all) {
    std::string text = info.num_samples > 0 ? "block,index,row,column,covariance,standard_error\n"
                                            : "block,index,row,column,covariance\n";
    for (const Blocks& blocks : all) {
        for (size_t row = 0; row < blocks.sizes.size(); ++row) {
            for_each_entry(covariance, blocks.block, row, blocks.sizes[row],
                           [&](double value, double error, size_t i, size_t j) {
                               char line[128];
                               const int length =
                                   std::snprintf(line, sizeof line, "%s,%zu,%zu,%zu,%.17g",
                                                 blocks.name, row, i, j, value);
                               text.append(line, static_cast<size_t>(length));
                               if (info.num_samples > 0) {
                                   std::snprintf(line, sizeof line, ",%.17g", error);
                                   text += line;
                               }
                               text += '\n';
                           });
        }
    }
    return text;
}

Json finite(double value) {
    return std::isfinite(value) ? Json(value) : Json();
}

std::string json_text(const clba_covariance* covariance, const clba_covariance_info& info,
                      const std::vector<Blocks>& all) {
    Json json = {
        {"gauge", clba_covariance_gauge_name(info.gauge)},
        {"gauge_images", info.gauge_images},
        {"num_freedoms", info.num_freedoms},
        {"method", clba_covariance_method_name(info.method)},
        {"num_samples", info.num_samples},
        {"relative_error", info.relative_error},
        {"cost", info.cost},
        {"redundancy", info.redundancy},
        {"variance_factor", finite(info.variance_factor)},
        {"variance_factor_is_applied", info.variance_factor_is_applied != 0},
        {"num_undetermined_parameters", info.num_undetermined_parameters},
        {"num_undetermined_points", info.num_undetermined_points},
        {"total_seconds", info.total_seconds},
    };
    for (const Blocks& blocks : all) {
        Json& rows = json[blocks.name] = Json::array();
        for (size_t row = 0; row < blocks.sizes.size(); ++row) {
            Json triangle = Json::array();
            for_each_entry(
                covariance, blocks.block, row, blocks.sizes[row],
                [&](double value, double, size_t, size_t) { triangle.push_back(finite(value)); });
            rows.push_back(std::move(triangle));
        }
    }
    return json.dump(1) + '\n';
}

bool ends_in_json(const std::string& path) {
    const std::string end = ".json";
    return path.size() >= end.size() &&
           path.compare(path.size() - end.size(), end.size(), end) == 0;
}

void print_line(const clba_covariance_info& info) {
    std::printf("Covariances                  %s, gauge %s",
                clba_covariance_method_name(info.method), clba_covariance_gauge_name(info.gauge));
    if (info.gauge_images[0] >= 0)
        std::printf(" (images %d and %d)", info.gauge_images[0], info.gauge_images[1]);
    if (info.num_samples > 0)
        std::printf(", %d samples: variances to %.1f %%", info.num_samples,
                    100 * info.relative_error);
    std::printf(", %.2f s\nVariance factor              %.4g%s\n", info.total_seconds,
                info.variance_factor, info.variance_factor_is_applied ? ", applied" : "");
    if (info.num_undetermined_points > 0)
        std::printf("Points without parallax      %lld\n",
                    static_cast<long long>(info.num_undetermined_points));
}

}  // namespace

CovarianceArguments::CovarianceArguments() {
    check(clba_covariance_options_init(&options, sizeof options));
}

void add_covariance_options(CLI::App& command, CovarianceArguments& arguments) {
    CLI::Option* file =
        command
            .add_option("--covariance", arguments.file,
                        "file of the covariances of poses and intrinsics: JSON if it ends in "
                        ".json, else CSV")
            ->check(not_empty);
    command.add_flag("--covariance-points", arguments.all_points, "points' covariances too")
        ->needs(file);
    add_choice(command, "--covariance-gauge", arguments.options.gauge, clba_covariance_gauge_name,
               "what takes the freedoms of a similarity away")
        ->needs(file);
    command
        .add_option("--gauge-images", arguments.images,
                    "the image whose pose the gauge holds, and the one whose distance from it")
        ->needs(file)
        ->expected(2);
    command.add_option("--gauge-points", arguments.points, "that three_points holds")
        ->needs(file)
        ->expected(3);
    add_choice(command, "--covariance-method", arguments.options.method,
               clba_covariance_method_name, "exact, or estimated from random samples")
        ->needs(file);
    command
        .add_flag("--variance-factor", arguments.apply_variance_factor,
                  "multiply covariances by the a posteriori variance factor")
        ->needs(file);
}

void write_covariances(clba_problem* problem, clba_context* context,
                       const CovarianceArguments& arguments, bool quiet) {
    clba_covariance_options options = arguments.options;
    std::copy(arguments.images.begin(), arguments.images.end(), options.gauge_images);
    std::copy(arguments.points.begin(), arguments.points.end(), options.gauge_points);
    options.all_points = arguments.all_points;
    options.apply_variance_factor = arguments.apply_variance_factor;
    clba_covariance* made = nullptr;
    check(clba_problem_covariance(problem, context, &options, &made));
    const Covariance covariance(made);
    clba_covariance_info info = {};
    info.struct_size = sizeof info;
    check(clba_covariance_get_info(made, &info));
    const std::vector<Blocks> blocks = list_blocks(problem, info);
    write_text(arguments.file, ends_in_json(arguments.file) ? json_text(made, info, blocks)
                                                            : csv_text(made, info, blocks));
    if (!quiet) print_line(info);
}

}  // namespace cli
