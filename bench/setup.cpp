// SPDX-License-Identifier: Apache-2.0
// Nanoseconds per observation of what a solve does once: a problem's tiles, its mirror on the
// device that CLBA_DEVICE names, and the reference cost.
//   bench/setup [problem.bal ...] [--benchmark_repetitions=5]
// Without files: generated scenes of about CLBA_BENCH_OBSERVATIONS (1e6) observations.
#include <benchmark/benchmark.h>

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/error.hpp"
#include "device/context.hpp"
#include "device/program_cache.hpp"
#include "io/bal.hpp"
#include "linear/device_problem.hpp"
#include "reference/bundle.hpp"
#include "reference/scene.hpp"

namespace {

using namespace clba;

std::string environment(const char* name, const char* otherwise) {
    const char* value = std::getenv(name);
    return value && *value ? value : otherwise;
}

struct NamedProblem {
    std::string name;
    Problem problem;
};

NamedProblem generated(const char* name, SceneKind kind, int32_t num_images) {
    SceneOptions options;
    options.kind = kind;
    options.num_images = num_images;
    options.observations_per_image =
        static_cast<int32_t>(std::stod(environment("CLBA_BENCH_OBSERVATIONS", "1e6")) / num_images);
    options.seed = 1;
    return {name, generate_scene(options).start};
}

std::string base_name(const std::string& path) {
    return path.substr(path.find_last_of('/') + 1);
}

void report(benchmark::State& state, const Problem& problem) {
    state.counters["s/obs"] = benchmark::Counter(
        static_cast<double>(problem.num_observations()),
        benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

// How well the tiles suit the kernels: slots of an observation, observations of a run.
void report_tiles(benchmark::State& state, const VisibilityTiles& tiles) {
    double num_runs = 0, num_tiles = 0;
    for (const Chunk& chunk : tiles.chunks) {
        num_tiles += chunk.num_tiles();
        for (const Segment& segment : chunk.segments) num_runs += segment.num_runs();
    }
    const double num_observations = state.counters["observations"];
    state.counters["tiles"] = num_tiles;
    state.counters["slots/obs"] = static_cast<double>(tiles.num_slots) / num_observations;
    state.counters["obs/run"] = num_observations / num_runs;
}

void register_benches(const std::shared_ptr<Context>& context, const NamedProblem& named) {
    const Problem& problem = named.problem;
    const auto add = [&](const char* what, auto&& work) {
        benchmark::RegisterBenchmark((named.name + '/' + what).c_str(),
                                     [&problem, work](benchmark::State& state) {
                                         work(state);
                                         report(state, problem);
                                     })
            ->MeasureProcessCPUTime()
            ->UseRealTime()
            ->Unit(benchmark::kMillisecond);
    };
    add("device_problem", [&problem, context](benchmark::State& state) {
        std::optional<DeviceProblem> device;
        for (auto _ : state) {
            state.PauseTiming();
            device.reset();
            state.ResumeTiming();
            device.emplace(context, problem, Precision::mixed);
            device->upload_state(problem);
            device->queue().finish();
        }
        state.counters["observations"] = static_cast<double>(problem.num_observations());
        report_tiles(state, device->tiles());
    });
    add("tiles", [&problem](benchmark::State& state) {
        const ParameterLayout layout(problem);
        std::optional<VisibilityTiles> tiles;
        for (auto _ : state) {
            state.PauseTiming();
            tiles.reset();
            state.ResumeTiming();
            tiles.emplace(problem, layout, TileOptions());
        }
    });
    add("reference_residual", [&problem](benchmark::State& state) {
        for (auto _ : state) benchmark::DoNotOptimize(reference::residual(problem, nullptr).cost);
    });
}

}  // namespace

int main(int argc, char** argv) {
    benchmark::Initialize(&argc, argv);
    try {
        ContextOptions options;
        options.device = environment("CLBA_DEVICE", "");
        options.cache_folder = ProgramCache::default_folder();
        const auto context = std::make_shared<Context>(options);
        std::vector<NamedProblem> problems;
        for (int i = 1; i < argc; ++i) problems.push_back({base_name(argv[i]), read_bal(argv[i])});
        if (argc <= 1) {
            problems.push_back(generated("hall", SceneKind::hall, 356));
            problems.push_back(generated("street", SceneKind::street, 5000));
            problems.push_back(generated("landmark", SceneKind::landmark, 1000));
        }
        for (const NamedProblem& named : problems) register_benches(context, named);
        benchmark::RunSpecifiedBenchmarks();
    } catch (const Error& error) {
        std::fprintf(stderr, "setup: %s\n", error.what());
        return 1;
    }
    return 0;
}
