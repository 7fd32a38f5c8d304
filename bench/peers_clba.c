/* SPDX-License-Identifier: Apache-2.0
 * Solves one BAL problem by clba's C ABI alone and prints what happened as lines of JSON, for
 * bench/peers.py:
 *   {"event":"warmed", ...}    one iteration was done, so that every kernel is compiled and loaded
 *   {"event":"loaded", ...}    the arrays are in host memory; the clock starts here
 *   {"event":"row", ...}       one an iteration, as it ends: seconds by the clock, cost kept
 *   {"event":"summary", ...}
 * The device is chosen by CLBA_DEVICE. */
#define _POSIX_C_SOURCE 200112L
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clba/clba.h"
#include "peers_memory.h"

static void check(clba_status status) {
    if (status == CLBA_OK) return;
    fprintf(stderr, "peers_clba: %s: %s\n", clba_status_string(status), clba_last_error());
    exit(2);
}

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static void* allocate(int64_t count, size_t size) {
    void* memory = calloc(count > 0 ? (size_t)count : 1, size);
    if (memory) return memory;
    fprintf(stderr, "peers_clba: out of memory\n");
    exit(2);
}

typedef struct arrays {
    clba_problem_info info;
    int32_t *models, *camera_indices, *images, *points;
    double *intrinsics, *poses, *xyz, *xy;
} arrays;

static arrays read_arrays(const char* path) {
    arrays a;
    clba_problem* problem = NULL;
    check(clba_problem_read_bal(path, &problem));
    a.info.struct_size = sizeof a.info;
    check(clba_problem_get_info(problem, &a.info));
    a.models = allocate(a.info.num_cameras, sizeof(int32_t));
    a.intrinsics = allocate(a.info.num_cameras, 3 * sizeof(double));
    a.camera_indices = allocate(a.info.num_images, sizeof(int32_t));
    a.poses = allocate(a.info.num_images, 7 * sizeof(double));
    a.xyz = allocate(a.info.num_points, 3 * sizeof(double));
    a.images = allocate(a.info.num_observations, sizeof(int32_t));
    a.points = allocate(a.info.num_observations, sizeof(int32_t));
    a.xy = allocate(a.info.num_observations, 2 * sizeof(double));
    check(clba_problem_get_cameras(problem, 0, a.info.num_cameras, a.models, 0, a.intrinsics, 0));
    check(clba_problem_get_images(problem, 0, a.info.num_images, a.camera_indices, 0, a.poses, 0));
    check(clba_problem_get_points(problem, 0, a.info.num_points, a.xyz, 0));
    check(clba_problem_get_observations(problem, 0, a.info.num_observations, a.images, 0, a.points,
                                        0, a.xy, 0));
    clba_problem_release(problem);
    return a;
}

static clba_problem* make_problem(const arrays* a) {
    clba_problem* problem = NULL;
    check(clba_problem_create(&problem));
    check(clba_problem_set_cameras(problem, a->info.num_cameras, a->models, 0, a->intrinsics, 0));
    check(clba_problem_set_images(problem, a->info.num_images, a->camera_indices, 0, a->poses, 0));
    check(clba_problem_set_points(problem, a->info.num_points, a->xyz, 0));
    check(clba_problem_set_observations(problem, a->info.num_observations, a->images, 0, a->points,
                                        0, a->xy, 0));
    return problem;
}

/* The options whose values have names in the library. */
typedef const char* (*name_fn)(int32_t value);
typedef struct named_option {
    const char* option;
    name_fn name;
    size_t offset; /* of an int32_t in clba_solver_options */
} named_option;
static const named_option named_options[] = {
    {"--linear-solver", clba_linear_solver_name, offsetof(clba_solver_options, linear_solver)},
    {"--preconditioner", clba_preconditioner_name, offsetof(clba_solver_options, preconditioner)},
    {"--precision", clba_precision_name, offsetof(clba_solver_options, precision)},
    {"--damping", clba_damping_name, offsetof(clba_solver_options, damping)},
};

/* The options that are numbers. */
typedef struct double_option {
    const char* option;
    size_t offset; /* of a double in clba_solver_options */
} double_option;
static const double_option double_options[] = {
    {"--max-seconds", offsetof(clba_solver_options, max_seconds)},
    {"--eta", offsetof(clba_solver_options, eta)},
    {"--initial-radius", offsetof(clba_solver_options, initial_trust_region_radius)},
    {"--min-damping-diagonal", offsetof(clba_solver_options, min_damping_diagonal)},
};
typedef struct int_option {
    const char* option;
    size_t offset; /* of an int32_t in clba_solver_options */
} int_option;
static const int_option int_options[] = {
    {"--max-iterations", offsetof(clba_solver_options, max_num_iterations)},
    {"--max-linear-solver-iterations", offsetof(clba_solver_options, max_linear_solver_iterations)},
};

static void fail_usage(const char* what, const char* value) {
    fprintf(stderr,
            "peers_clba: %s %s\n"
            "usage: peers_clba FILE [--linear-solver L] [--preconditioner P] [--precision P]\n"
            "  [--damping D] [--eta E] [--initial-radius R] [--min-damping-diagonal D]\n"
            "  [--max-linear-solver-iterations N] [--max-iterations M] [--max-seconds S]; the "
            "values are those of `clba solve`\n",
            what, value);
    exit(2);
}

static int32_t value_of(const named_option* option, const char* text) {
    for (int32_t value = 0; value < 64; ++value) {
        const char* name = option->name(value);
        if (name && strcmp(name, text) == 0) return value;
    }
    fail_usage(option->option, text);
    return -1;
}

/* 1 if the option is one of clba_solver_options. */
static int set_option(clba_solver_options* options, const char* option, const char* value) {
    char* base = (char*)options;
    for (size_t i = 0; i < sizeof named_options / sizeof *named_options; ++i)
        if (strcmp(option, named_options[i].option) == 0) {
            const int32_t number = value_of(&named_options[i], value);
            memcpy(base + named_options[i].offset, &number, sizeof number);
            return 1;
        }
    for (size_t i = 0; i < sizeof double_options / sizeof *double_options; ++i)
        if (strcmp(option, double_options[i].option) == 0) {
            const double number = atof(value);
            memcpy(base + double_options[i].offset, &number, sizeof number);
            return 1;
        }
    for (size_t i = 0; i < sizeof int_options / sizeof *int_options; ++i)
        if (strcmp(option, int_options[i].option) == 0) {
            const int32_t number = atoi(value);
            memcpy(base + int_options[i].offset, &number, sizeof number);
            return 1;
        }
    return 0;
}

/* user_data: the double at which the clock started. */
static int32_t print_row(const clba_iteration* row, void* user_data) {
    printf(
        "{\"event\":\"row\",\"iteration\":%d,\"seconds\":%.6f,\"cost\":%.17g,\"accepted\":%d,"
        "\"linear_solver_iterations\":%d,\"trust_region_radius\":%.6g}\n",
        row->iteration, now() - *(const double*)user_data, row->cost, row->step_is_accepted,
        row->linear_solver_iterations, row->trust_region_radius);
    fflush(stdout);
    return 0;
}

/* seconds: from the arrays to the solution. */
static clba_summary solve(const arrays* a, clba_context* context,
                          const clba_solver_options* options, double* seconds) {
    const double start = now();
    clba_problem* problem = make_problem(a);
    clba_result* result = NULL;
    clba_summary summary;
    check(clba_problem_solve(problem, context, options, &result));
    *seconds = now() - start;
    summary.struct_size = sizeof summary;
    check(clba_result_get_summary(result, &summary));
    clba_result_release(result);
    clba_problem_release(problem);
    return summary;
}

int main(int argc, char** argv) {
    const char* file = NULL;
    clba_solver_options options;
    check(clba_solver_options_init(&options, sizeof options));
    options.max_num_iterations = 100;
    options.function_tolerance = 1e-9;
    options.gradient_tolerance = 1e-10;
    options.parameter_tolerance = 1e-10;
    for (int i = 1; i < argc; ++i) {
        if (strncmp(argv[i], "--", 2) != 0)
            file = argv[i];
        else if (i + 1 == argc)
            fail_usage(argv[i], "needs a value");
        else if (set_option(&options, argv[i], argv[i + 1]))
            ++i;
        else
            fail_usage("unknown option", argv[i]);
    }
    if (!file) fail_usage("no file", "");

    const double read_start = now();
    const arrays a = read_arrays(file);
    const double read_seconds = now() - read_start;

    clba_context* context = NULL;
    check(clba_context_create(NULL, &context));
    clba_solver_options warm_up_options = options;
    warm_up_options.max_num_iterations = 1;
    double warm_up_seconds = 0, total_seconds = 0;
    clba_summary warm_up = solve(&a, context, &warm_up_options, &warm_up_seconds);
    if (options.linear_solver == CLBA_LINEAR_SOLVER_AUTO) { /* what it may go over to */
        double more_seconds = 0;
        warm_up_options.linear_solver = CLBA_LINEAR_SOLVER_EXPLICIT_SCHUR;
        const double build_seconds = warm_up.build_seconds;
        warm_up = solve(&a, context, &warm_up_options, &more_seconds);
        warm_up.build_seconds += build_seconds;
        warm_up_seconds += more_seconds;
    }
    printf("{\"event\":\"warmed\",\"seconds\":%.6f,\"build_seconds\":%.6f,\"device\":\"%s\"}\n",
           warm_up_seconds, warm_up.build_seconds, warm_up.device);

    const uint32_t version = clba_version();
    peers_reset_peak_memory();
    printf(
        "{\"event\":\"loaded\",\"read_seconds\":%.3f,\"images\":%d,\"points\":%d,"
        "\"observations\":%lld,\"start_bytes\":%llu,\"version\":\"%u.%u.%u\"}\n",
        read_seconds, a.info.num_images, a.info.num_points, (long long)a.info.num_observations,
        peers_peak_memory(), version / 10000, version / 100 % 100, version % 100);
    fflush(stdout);

    double start = now();
    options.on_iteration = print_row;
    options.user_data = &start;
    const clba_summary s = solve(&a, context, &options, &total_seconds);
    printf(
        "{\"event\":\"summary\",\"initial_cost\":%.17g,\"final_cost\":%.17g,"
        "\"device_final_cost\":%.17g,\"total_seconds\":%.6f,\"build_seconds\":%.6f,"
        "\"setup_seconds\":%.6f,\"linearize_seconds\":%.6f,\"linear_solver_seconds\":%.6f,"
        "\"evaluate_seconds\":%.6f,\"reference_seconds\":%.6f,\"usable\":%d,"
        "\"termination\":\"%s\",\"reason\":%d,\"linear_solver_iterations\":%d,"
        "\"peak_device_bytes\":%llu,\"peak_bytes\":%llu}\n",
        s.initial_cost, s.reference_final_cost, s.final_cost, total_seconds, s.build_seconds,
        s.setup_seconds, s.linearize_seconds, s.linear_solver_seconds, s.evaluate_seconds,
        s.reference_seconds, s.termination != CLBA_FAILURE,
        s.termination == CLBA_CONVERGENCE ? "CONVERGENCE"
        : s.termination == CLBA_FAILURE   ? "FAILURE"
                                          : "NO_CONVERGENCE",
        s.reason, s.num_linear_solver_iterations, (unsigned long long)s.peak_device_bytes,
        peers_peak_memory());
    clba_context_release(context);
    return 0;
}
