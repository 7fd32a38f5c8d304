// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <memory>

#include "cli/commands.hpp"
#include "cli/handles.hpp"
#include "cli/options.hpp"
#include "cli/outputs.hpp"

namespace cli {
namespace {

struct GenerateArguments {
    GenerateArguments() { check(clba_scene_options_init(&scene, sizeof scene)); }
    clba_scene_options scene = {};
    std::string output;
    std::string truth;
};

void write_scene(const clba_problem* problem, const std::string& path) {
    check(clba_problem_write_bal(problem, path.c_str()));
    const clba_problem_info info = info_of(problem);
    std::printf("%s: %d images, %d points, %lld observations\n", path.c_str(), info.num_images,
                info.num_points, static_cast<long long>(info.num_observations));
}

void generate(const GenerateArguments& arguments) {
    check_outputs({"", {arguments.output, arguments.truth}});
    clba_problem* start = nullptr;
    clba_problem* truth = nullptr;
    check(clba_problem_generate(&arguments.scene, &start,
                                arguments.truth.empty() ? nullptr : &truth));
    const Problem owned_start(start), owned_truth(truth);
    write_scene(start, arguments.output);
    if (truth) write_scene(truth, arguments.truth);
}

}  // namespace

void add_generate(CLI::App& program) {
    CLI::App* command =
        program.add_subcommand("generate", "Generate a scene with known truth; needs no device");
    const auto arguments = std::make_shared<GenerateArguments>();
    clba_scene_options& scene = arguments->scene;
    add_choice(*command, "KIND", scene.scene, clba_scene_name, "kind of scene")->required();
    command
        ->add_option("-o,--output", arguments->output,
                     "BAL file of the disturbed start; compressed if it ends in .gz or .bz2")
        ->check(not_empty)
        ->required();
    command->add_option("--truth", arguments->truth, "BAL file of the true state");
    command->add_option("--images", scene.num_images, "number of images")->capture_default_str();
    command->add_option("--points", scene.num_points, "number of points; 0: as many as fit")
        ->capture_default_str();
    command
        ->add_option("--observations-per-image", scene.observations_per_image,
                     "observations an image, about")
        ->capture_default_str();
    command
        ->add_option("--noise", scene.pixel_noise, "standard deviation of the observations, pixels")
        ->capture_default_str();
    command
        ->add_option("--outliers", scene.outlier_share,
                     "share of observations moved anywhere in the image")
        ->capture_default_str();
    command->add_option("--seed", scene.seed, "equal seeds give equal scenes")
        ->check(non_negative_number)
        ->capture_default_str();
    command
        ->add_option("--rotation-noise", scene.rotation_noise,
                     "disturbance of the start's rotations, degrees")
        ->capture_default_str();
    command
        ->add_option("--position-noise", scene.position_noise,
                     "of its camera centres, share of the distance to the scene")
        ->capture_default_str();
    command->add_option("--point-noise", scene.point_noise, "of its points, the same share")
        ->capture_default_str();
    command->callback([arguments] { generate(*arguments); });
}

}  // namespace cli
