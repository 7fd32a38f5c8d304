// SPDX-License-Identifier: Apache-2.0
// What a problem of any size costs in time and memory, for bench/scale.py: every call is a process
// of its own and prints one JSON object.
//   bench/scale generate SCENE IMAGES OBSERVATIONS POINTS FILE   the start of a scene (POINTS 0:
//                                                                tracks of 5)
//   bench/scale time FILE                         seconds of set-up, product, linearisation, cost
//   bench/scale solve FILE SOLVER MAX_ITERATIONS MAX_LINEAR_SOLVER_ITERATIONS   bytes of a solve
// All in mixed with the recomputed Jacobian, on the device that CLBA_DEVICE names. FILE is this
// program's own: arrays as they lie in memory.
#include <algorithm>
#include <chrono>
#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include "base/error.hpp"
#include "device/context.hpp"
#include "device/program_cache.hpp"
#include "linear/normal_equations.hpp"
#include "optimizer/evaluator.hpp"
#include "optimizer/solve.hpp"
#include "problem/visibility_tiles.hpp"
#include "reference/scene.hpp"

namespace {

using namespace clba;

// ---- Memory of this process, from /proc: 0 where there is none

void reset_peak_memory() {
#ifdef __GLIBC__
    malloc_trim(0);
#endif
    std::FILE* file = std::fopen("/proc/self/clear_refs", "w");
    if (!file) return;
    std::fputs("5", file);  // VmHWM becomes VmRSS
    std::fclose(file);
}

int64_t memory_bytes(const char* field) {
    std::FILE* file = std::fopen("/proc/self/status", "r");
    if (!file) return 0;
    int64_t kib = 0;
    const std::string format = text(field, ": %" SCNd64 " kB");
    for (char line[256]; std::fgets(line, sizeof line, file);)
        if (std::sscanf(line, format.c_str(), &kib) == 1) break;
    std::fclose(file);
    return 1024 * kib;
}
int64_t resident_memory() {
    return memory_bytes("VmRSS");
}
int64_t peak_memory() {
    return memory_bytes("VmHWM");
}

// ---- Files

using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;

File open_file(const std::string& path, const char* mode) {
    File file(std::fopen(path.c_str(), mode), std::fclose);
    if (!file) fail(Status::file, path, " cannot be opened");
    return file;
}

template <class Row>
void write_rows(std::FILE* file, const std::vector<Row>& rows) {
    static_assert(std::is_trivially_copyable_v<Row>);
    const uint64_t count = rows.size();
    if (std::fwrite(&count, sizeof count, 1, file) != 1 ||
        std::fwrite(rows.data(), sizeof(Row), rows.size(), file) != rows.size())
        fail(Status::file, "the problem cannot be written");
}

template <class Row>
void read_rows(std::FILE* file, std::vector<Row>& rows) {
    uint64_t count = 0;
    if (std::fread(&count, sizeof count, 1, file) != 1)
        fail(Status::file, "the problem ends early");
    rows.resize(count);
    if (std::fread(rows.data(), sizeof(Row), rows.size(), file) != rows.size())
        fail(Status::file, "the problem ends early");
}

Problem load(const std::string& path) {
    const File file = open_file(path, "rb");
    Problem problem;
    read_rows(file.get(), problem.cameras);
    read_rows(file.get(), problem.images);
    read_rows(file.get(), problem.points);
    read_rows(file.get(), problem.observations);
    problem.validate();
    return problem;
}

// ---- Time

// Of all threads; unlike wall time it hardly rises when other programs share the machine.
double processor_time() {
    timespec time{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

// Medians.
struct Seconds {
    double wall = 0;
    double processor = 0;
};

double median(std::vector<double> values) {
    const auto middle = values.begin() + static_cast<int64_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

// Of `work`, repeated for a second or more, but not beyond most_samples.
Seconds measure(int most_samples, const std::function<void()>& work) {
    constexpr double least_seconds = 1;
    std::vector<double> walls, processors;
    double total = 0;
    while (static_cast<int>(walls.size()) < most_samples &&
           (total < least_seconds || walls.size() < 9)) {
        const double processor_start = processor_time();
        const auto start = std::chrono::steady_clock::now();
        work();
        walls.push_back(
            std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
        processors.push_back(processor_time() - processor_start);
        total += walls.back();
    }
    return {median(walls), median(processors)};
}

// ---- The commands

std::shared_ptr<Context> make_context() {
    ContextOptions options;
    if (const char* device = std::getenv("CLBA_DEVICE")) options.device = device;
    options.cache_folder = ProgramCache::default_folder();
    return std::make_shared<Context>(options);
}

SceneOptions scene_options(const std::string& scene, int32_t num_images, int64_t num_observations,
                           int32_t num_points) {
    SceneOptions options;
    require(scene == "hall" || scene == "street" || scene == "landmark", "the scene ", scene,
            " is none of hall, street and landmark");
    require(num_images > 0, "there are ", num_images, " images, but there must be some");
    options.kind = scene == "hall"     ? SceneKind::hall
                   : scene == "street" ? SceneKind::street
                                       : SceneKind::landmark;
    options.num_images = num_images;
    options.observations_per_image =
        static_cast<int32_t>((num_observations + num_images / 2) / num_images);
    options.num_points = num_points;
    options.seed = 1;
    return options;
}

void generate(const SceneOptions& options, const std::string& path) {
    double processor = processor_time();
    const Problem start = generate_scene(options).start;
    processor = processor_time() - processor;
    const File file = open_file(path, "wb");
    write_rows(file.get(), start.cameras);
    write_rows(file.get(), start.images);
    write_rows(file.get(), start.points);
    write_rows(file.get(), start.observations);
    std::printf("{\"images\": %d, \"points\": %d, \"observations\": %" PRId64
                ", \"generate_processor_seconds\": %.3f, \"generate_peak_bytes\": %" PRId64 "}\n",
                start.num_images(), start.num_points(), start.num_observations(), processor,
                peak_memory());
}

TileOptions tile_options(const Context& context) {
    TileOptions options;
    options.max_points_per_tile = context.tuning.points_per_tile;
    options.compute_units = context.device().compute_units;
    options.lanes = context.tuning.lanes;
    options.bytes_per_value = static_cast<int64_t>(real_bytes(Precision::mixed));
    options.max_buffer_bytes = context.max_allocation_bytes();
    return options;
}

void print_seconds(const char* name, const Seconds& seconds) {
    std::printf(", \"%s_seconds\": %.6g, \"%s_processor_seconds\": %.6g", name, seconds.wall, name,
                seconds.processor);
}

void time_kernels(const std::string& path) {
    const auto context = make_context();
    const Problem problem = load(path);
    constexpr int few = 3, many = 400;
    const ParameterLayout layout(problem);
    const Seconds of_tiles =
        measure(few, [&] { VisibilityTiles(problem, layout, tile_options(*context)); });
    std::optional<DeviceProblem> device;
    const Seconds of_setup = measure(few, [&] {
        device.reset();
        device.emplace(context, problem, Precision::mixed);
        device->upload_state(problem);
        device->queue().finish();
    });
    Evaluator evaluator(*device, problem);
    NormalEquations equations(*device, DampingOptions(), JacobianForm::recomputed, problem.loss);
    Vector x = device->make_reduced_vector("x"), y = device->make_reduced_vector("y");
    evaluator.linearize(equations);
    equations.factor_points(1e-4);
    equations.factor_image_blocks(1e-4);
    equations.apply_image_factors(equations.gradient, x);

    const auto measure_kernels = [&](const std::function<void()>& work) {
        const auto finished = [&] {
            work();
            device->queue().finish();
        };
        finished();  // the first launch may compile
        return measure(many, finished);
    };
    const Seconds of_product = measure_kernels(
        [&] { equations.jacobian.add_schur_product(x, equations.point_factors(), y); });
    const Seconds of_cost = measure_kernels([&] { evaluator.cost(device->state, nullptr); });
    const Seconds of_linearize = measure_kernels([&] { evaluator.linearize(equations); });

    int64_t num_tiles = 0, num_runs = 0;
    for (const DeviceChunk& chunk : device->chunks()) {
        num_tiles += chunk.num_tiles;
        for (const DeviceSegment& segment : chunk.segments) num_runs += segment.num_runs;
    }
    std::printf("{\"chunks\": %zu, \"tiles\": %" PRId64 ", \"runs\": %" PRId64
                ", \"slots\": %" PRId64 ", \"compute_units\": %d, \"device\": \"%s\"",
                device->chunks().size(), num_tiles, num_runs, device->tiles().num_slots,
                context->device().compute_units, context->device().name.c_str());
    print_seconds("tiles", of_tiles);
    print_seconds("setup", of_setup);
    print_seconds("product", of_product);
    print_seconds("linearize", of_linearize);
    print_seconds("cost", of_cost);
    std::printf("}\n");
}

Summary solve_in(std::unique_ptr<DeviceProblem>& device, Problem& problem,
                 const std::shared_ptr<Context>& context, LinearSolverKind kind, int max_iterations,
                 int max_linear_solver_iterations) {
    MinimizerOptions options;
    options.linear_solver.kind = kind;
    options.linear_solver.max_iterations = max_linear_solver_iterations;
    options.max_iterations = max_iterations;
    return solve(problem, context, options, Precision::mixed, device);
}

// Host bytes are what is resident beyond what was before the problem was loaded and beyond what the
// device's buffers hold: a device that works in the host's memory has these in this process too.
void solve_file(const std::string& path, const std::string& solver, int max_iterations,
                int max_linear_solver_iterations) {
    require(solver == "pcg_schur" || solver == "auto", "the linear solver ", solver,
            " is none of pcg_schur and auto");
    const LinearSolverKind kind =
        solver == "auto" ? LinearSolverKind::automatic : LinearSolverKind::pcg_schur;
    const auto context = make_context();
    // Loads all kernels: a compiler's memory is not the problem's.
    for (const LinearSolverKind loaded :
         {LinearSolverKind::pcg_schur, LinearSolverKind::explicit_schur}) {
        Problem small = generate_scene(SceneOptions()).start;
        std::unique_ptr<DeviceProblem> device;
        solve_in(device, small, context, loaded, 1, max_linear_solver_iterations);
    }
    reset_peak_memory();
    const int64_t before = resident_memory();
    Problem problem = load(path);
    const int64_t problem_bytes = resident_memory() - before;

    // Nothing is on the device while the tiles are built.
    { VisibilityTiles(problem, ParameterLayout(problem), tile_options(*context)); }
    const int64_t tiles_peak = peak_memory() - before;

    std::unique_ptr<DeviceProblem> device;
    mirror(problem, context, Precision::mixed, device).queue().finish();
    reset_peak_memory();
    const auto mirror_bytes = static_cast<int64_t>(device->queue().memory().current_bytes);
    const int64_t host_bytes = resident_memory() - before - mirror_bytes;
    const Summary summary =
        solve_in(device, problem, context, kind, max_iterations, max_linear_solver_iterations);
    const auto device_bytes = static_cast<int64_t>(summary.peak_device_bytes);
    const int64_t solve_peak = peak_memory() - before - device_bytes;
    std::printf("{\"device_bytes\": %" PRId64 ", \"mirror_bytes\": %" PRId64
                ", \"host_problem_bytes\": %" PRId64 ", \"host_tiles_peak_bytes\": %" PRId64
                ", \"host_kept_bytes\": %" PRId64 ", \"host_solve_peak_bytes\": %" PRId64
                ", \"host_bytes\": %" PRId64 ", \"process_peak_bytes\": %" PRId64,
                device_bytes, mirror_bytes, problem_bytes, tiles_peak, host_bytes, solve_peak,
                std::max({tiles_peak, host_bytes, solve_peak}), peak_memory());
    std::printf(
        ", \"linear_solver\": %d, \"iterations\": %zu, \"linear_solver_iterations\": %d"
        ", \"initial_cost\": %.10g, \"final_cost\": %.10g, \"reference_final_cost\": %.10g"
        ", \"solve_seconds\": %.3f, \"solve_processor_seconds\": %.3f, \"termination\": \"%s\"}\n",
        static_cast<int>(summary.linear_solver), summary.rows.size() - 1,
        summary.num_linear_solver_iterations, summary.initial_cost, summary.final_cost,
        summary.reference_final_cost, summary.total_seconds, processor_time(),
        summary.message.c_str());
}

int run(const std::vector<std::string>& arguments) {
    const std::string command = arguments.empty() ? "" : arguments[0];
    if (command == "generate" && arguments.size() == 6)
        generate(scene_options(arguments[1], std::stoi(arguments[2]), std::stoll(arguments[3]),
                               std::stoi(arguments[4])),
                 arguments[5]);
    else if (command == "time" && arguments.size() == 2)
        time_kernels(arguments[1]);
    else if (command == "solve" && arguments.size() == 5)
        solve_file(arguments[1], arguments[2], std::stoi(arguments[3]), std::stoi(arguments[4]));
    else
        fail(Status::invalid_argument,
             "usage: scale generate SCENE IMAGES OBSERVATIONS POINTS FILE | time FILE | solve FILE "
             "SOLVER MAX_ITERATIONS MAX_LINEAR_SOLVER_ITERATIONS");
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        return run({argv + 1, argv + argc});
    } catch (const std::exception& error) {
        std::fprintf(stderr, "scale: %s\n", error.what());
        return 1;
    }
}
