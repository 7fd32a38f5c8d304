// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <memory>
#include <vector>

#include "cli/commands.hpp"
#include "cli/files.hpp"
#include "cli/handles.hpp"

namespace cli {
namespace {

void print_counts(const char* label, std::vector<int64_t>& counts) {
    if (counts.empty()) return;
    std::sort(counts.begin(), counts.end());
    int64_t sum = 0;
    for (int64_t count : counts) sum += count;
    const auto none = std::upper_bound(counts.begin(), counts.end(), 0) - counts.begin();
    const auto once = std::upper_bound(counts.begin(), counts.end(), 1) - counts.begin() - none;
    std::printf("%s min %lld, median %lld, mean %.2f, max %lld; %lld with none, %lld with one\n",
                label, static_cast<long long>(counts.front()),
                static_cast<long long>(counts[counts.size() / 2]),
                static_cast<double>(sum) / static_cast<double>(counts.size()),
                static_cast<long long>(counts.back()), static_cast<long long>(none),
                static_cast<long long>(once));
}

void print_info(const std::string& path) {
    const Problem problem = read_problem(path, false);
    const clba_problem_info info = info_of(problem.get());
    std::printf("format                  %s\n",
                clba_format_name(clba_problem_get_format(problem.get())));
    std::printf("images                  %d\n", info.num_images);
    std::printf("cameras                 %d, of which %d shared\n", info.num_cameras,
                info.num_shared_cameras);
    if (info.num_frames > 0)
        std::printf("rigs                    %d frames of %d sensors\n", info.num_frames,
                    info.num_sensors);
    std::printf("points                  %d\n", info.num_points);
    std::printf("observations            %lld\n", static_cast<long long>(info.num_observations));
    std::printf("parameters              %lld, of which %lld of images and cameras\n",
                static_cast<long long>(info.num_parameters),
                static_cast<long long>(info.num_image_camera_parameters));

    const size_t num_observations = static_cast<size_t>(info.num_observations);
    std::vector<int32_t> images(num_observations), points(num_observations);
    std::vector<double> xy(2 * num_observations);
    check(clba_problem_get_observations(problem.get(), 0, info.num_observations, images.data(), 0,
                                        points.data(), 0, xy.data(), 0));
    std::vector<int64_t> per_image(static_cast<size_t>(info.num_images));
    std::vector<int64_t> per_point(static_cast<size_t>(info.num_points));
    for (size_t i = 0; i < num_observations; ++i) {
        ++per_image[static_cast<size_t>(images[i])];
        ++per_point[static_cast<size_t>(points[i])];
    }
    print_counts("observations per image ", per_image);
    print_counts("observations per point ", per_point);
}

}  // namespace

void add_info(CLI::App& program) {
    CLI::App* command = program.add_subcommand("info", "Describe a problem; needs no device");
    const auto path = std::make_shared<std::string>();
    command->add_option("FILE", *path, problem_help)->required();
    command->callback([path] { print_info(*path); });
}

}  // namespace cli
