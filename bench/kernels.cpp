// SPDX-License-Identifier: Apache-2.0
// Nanoseconds per observation of every kernel family on the device that CLBA_DEVICE names, on a
// generated scene of about a million observations or on a BAL file:
//   bench/kernels [--benchmark_filter=...] [--benchmark_repetitions=5]
// CLBA_BENCH_SCENE: hall (default), street, landmark or the path of a BAL file;
// CLBA_BENCH_OBSERVATIONS: about how many a generated scene has;
// CLBA_BENCH_CAMERA: a camera model that all cameras get instead of snavely;
// CLBA_BENCH_PRIORS=1: every image has a prior of its position, and prior_product is what they add
// to an iteration of conjugate gradients.
#include <benchmark/benchmark.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "base/error.hpp"
#include "device/context.hpp"
#include "device/program_cache.hpp"
#include "io/bal.hpp"
#include "linear/device_problem.hpp"
#include "linear/explicit_schur.hpp"
#include "linear/normal_equations.hpp"
#include "linear/prior_terms.hpp"
#include "optimizer/evaluator.hpp"
#include "reference/scene.hpp"

namespace {

using namespace clba;

std::string environment(const char* name, const char* otherwise) {
    const char* value = std::getenv(name);
    return value && *value ? value : otherwise;
}

Problem generated_or_read() {
    SceneOptions options;
    const std::string scene = environment("CLBA_BENCH_SCENE", "hall");
    if (scene != "hall" && scene != "street" && scene != "landmark") return read_bal(scene);
    const double observations = std::stod(environment("CLBA_BENCH_OBSERVATIONS", "1e6"));
    options.kind = scene == "street"     ? SceneKind::street
                   : scene == "landmark" ? SceneKind::landmark
                                         : SceneKind::hall;
    options.num_images = scene == "street" ? 5000 : scene == "landmark" ? 1000 : 356;
    options.observations_per_image = static_cast<int32_t>(observations / options.num_images);
    options.seed = 1;
    return generate_scene(options).start;
}

// The scene through cameras of another model, which look along +z: y and z of their axes turn over.
void set_camera_model(const std::string& name, Problem& problem) {
    int32_t model = 0;
    while (model < num_camera_models && name != camera_models[model].name) ++model;
    if (model == num_camera_models)
        fail(Status::invalid_argument, "CLBA_BENCH_CAMERA=", name, " is no camera model");
    if (model == camera_snavely) return;
    for (Camera& camera : problem.cameras) {
        const double focal_length = camera.params[0];
        camera = Camera();
        camera.model = model;
        camera.params[0] = focal_length;
        if (camera_models[model].param_names[1] == 'x') camera.params[1] = focal_length;
        if (model == camera_fov) camera.params[4] = 0.5;
    }
    for (Image& image : problem.images) {
        image.pose.rotation = quaternion_product({0, 1, 0, 0}, image.pose.rotation);
        for (int k : {1, 2}) image.pose.translation[k] = -image.pose.translation[k];
    }
    for (Observation& observation : problem.observations) observation.y = -observation.y;
    problem.validate();
}

Problem bench_scene() {
    Problem scene = generated_or_read();
    if (environment("CLBA_BENCH_PRIORS", "0") != "1") return scene;
    for (int32_t i = 0; i < scene.num_images(); ++i)
        scene.priors.positions.push_back(
            {i, camera_center(scene.images[i].pose), {20, 0, 0, 2, 20, 0, 1, 3, 10}});
    return scene;
}

// Everything that the kernels work on, at the scene's start.
struct Rig {
    Rig(std::shared_ptr<Context> context, const Problem& scene, Precision precision,
        JacobianForm form)
        : device(std::move(context), scene, precision),
          evaluator((device.upload_state(scene), device), scene),
          equations(device, DampingOptions(), form, scene.loss),
          x(device.make_vector("x")),
          y(device.make_vector("y")),
          zero(device.make_reduced_vector("zero")),
          schur_blocks(device.queue(), device.matrices_bytes(), "blocks"),
          explicit_schur(scene, equations) {
        evaluator.linearize(equations);
        equations.factor_points(1e-4);
        equations.factor_image_blocks(1e-4);
        equations.apply_image_factors(equations.gradient, x);
        equations.get_gradient(y);
        equations.apply_point_factors(y, x);
        device.queue().finish();
    }
    DeviceProblem device;
    Evaluator evaluator;
    NormalEquations equations;
    Vector x, y, zero;
    Buffer schur_blocks;
    ExplicitSchur explicit_schur;
};

using Work = std::function<void(Rig&)>;

// Of all threads; unlike wall time it hardly rises when other programs share the machine.
double processor_time() {
    return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

void measure(benchmark::State& state, Rig& rig, const Work& work) {
    work(rig);  // the first launch may compile
    rig.device.queue().finish();
    double total_seconds = 0;
    const double processor_start = processor_time();
    for (auto _ : state) {
        const auto start = std::chrono::steady_clock::now();
        work(rig);
        rig.device.queue().finish();
        const double seconds =
            std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
        state.SetIterationTime(seconds);
        total_seconds += seconds;
    }
    const double processor_seconds = processor_time() - processor_start;
    state.counters["cpu_ns/obs"] = 1e9 * processor_seconds /
                                   static_cast<double>(state.iterations()) /
                                   static_cast<double>(rig.device.num_observations());
    state.counters["ns/obs"] = 1e9 * total_seconds / static_cast<double>(state.iterations()) /
                               static_cast<double>(rig.device.num_observations());
}

}  // namespace

int main(int argc, char** argv) {
    benchmark::Initialize(&argc, argv);
    if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
    try {
        ContextOptions options;
        options.device = environment("CLBA_DEVICE", "");
        options.cache_folder = ProgramCache::default_folder();
        const auto context = std::make_shared<Context>(options);
        Problem scene = bench_scene();
        set_camera_model(environment("CLBA_BENCH_CAMERA", "snavely"), scene);
        std::printf("device %s; %d images, %d points, %lld observations\n",
                    context->device().name.c_str(), scene.num_images(), scene.num_points(),
                    static_cast<long long>(scene.num_observations()));
        const std::pair<const char*, Work> works[] = {
            {"residual", [](Rig& rig) { rig.evaluator.cost(rig.device.state, nullptr); }},
            {"linearize", [](Rig& rig) { rig.evaluator.linearize(rig.equations); }},
            {"linearize_u_v_inverse",
             [](Rig& rig) {
                 rig.evaluator.linearize(rig.equations);
                 rig.equations.u();
                 rig.equations.factor_points(1e-4);
             }},
            {"jx", [](Rig& rig) { rig.equations.jacobian.multiply(rig.x); }},
            {"jty", [](Rig& rig) { rig.equations.jacobian.add_transposed(rig.y); }},
            {"schur_product",
             [](Rig& rig) {
                 rig.equations.jacobian.add_schur_product(rig.x, rig.equations.point_factors(),
                                                          rig.y);
             }},
            {"prior_product",
             [](Rig& rig) {
                 if (PriorTerms* priors = rig.device.priors())
                     priors->add_image_product(rig.x.f, rig.y.f);
             }},
            {"image_blocks",
             [](Rig& rig) { rig.equations.jacobian.image_blocks(rig.schur_blocks); }},
            {"eliminate",
             [](Rig& rig) {
                 rig.equations.jacobian.eliminate(rig.zero, rig.equations.point_gradient,
                                                  rig.equations.point_factors(), rig.y);
             }},
            {"back_substitute",
             [](Rig& rig) {
                 rig.equations.jacobian.back_substitute(rig.x, rig.equations.point_gradient,
                                                        rig.equations.point_factors());
             }},
            {"schur_blocks",
             [](Rig& rig) {
                 rig.equations.jacobian.schur_blocks(rig.equations.point_factors(),
                                                     rig.schur_blocks);
             }},
            {"explicit_blocks", [](Rig& rig) { rig.explicit_schur.form_blocks(); }},
            {"factor_points", [](Rig& rig) { rig.equations.factor_points(1e-4); }},
            {"factor_image_blocks", [](Rig& rig) { rig.equations.factor_image_blocks(1e-4); }},
            {"apply_point_factors",
             [](Rig& rig) { rig.equations.apply_point_factors(rig.x, rig.y); }},
            {"apply_image_factors",
             [](Rig& rig) { rig.equations.apply_image_factors(rig.x, rig.y); }},
            {"dot", [](Rig& rig) { rig.device.vectors().dot(rig.x, rig.y); }},
            {"update_state", [](Rig& rig) { rig.device.update(rig.x); }},
        };
        struct Variant {
            const char* name;
            Precision precision;
            JacobianForm form;
        };
        constexpr Variant variants[] = {
            {"mixed", Precision::mixed, JacobianForm::recomputed},
            {"double", Precision::double_precision, JacobianForm::recomputed},
            {"mixed_stored", Precision::mixed, JacobianForm::stored},
            {"double_stored", Precision::double_precision, JacobianForm::stored},
        };
        // One at a time, made when the first benchmark of its variant runs.
        std::unique_ptr<Rig> rig;
        const Variant* variant_of_rig = nullptr;
        const auto rig_of = [&](const Variant& variant) -> Rig& {
            if (variant_of_rig != &variant) {
                rig.reset();
                rig = std::make_unique<Rig>(context, scene, variant.precision, variant.form);
                variant_of_rig = &variant;
            }
            return *rig;
        };
        for (const Variant& variant : variants) {
            for (const auto& [name, work] : works)
                benchmark::RegisterBenchmark(text(variant.name, '/', name).c_str(),
                                             [&, work = work](benchmark::State& state) {
                                                 measure(state, rig_of(variant), work);
                                             })
                    ->UseManualTime()
                    ->Unit(benchmark::kMillisecond);
        }
        benchmark::RunSpecifiedBenchmarks();
    } catch (const Error& error) {
        std::fprintf(stderr, "kernels: %s\n", error.what());
        return 1;
    }
    return 0;
}
