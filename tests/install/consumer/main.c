/* SPDX-License-Identifier: Apache-2.0 */
/* Solves a small scene with both kinds of linear solver; 0 if the two agree, 77 without a device.
 */
#include <clba/clba.h>
#include <math.h>
#include <stdio.h>

static clba_status solve(clba_context* context, int32_t linear_solver, clba_summary* summary) {
    clba_scene_options scene;
    clba_solver_options options;
    clba_problem* problem = NULL;
    clba_result* result = NULL;
    clba_status status;
    summary->struct_size = sizeof *summary;
    if ((status = clba_scene_options_init(&scene, sizeof scene)) == CLBA_OK) {
        scene.num_images = 8;
        scene.observations_per_image = 60;
        status = clba_problem_generate(&scene, &problem, NULL);
    }
    if (status == CLBA_OK) status = clba_solver_options_init(&options, sizeof options);
    if (status == CLBA_OK) {
        options.linear_solver = linear_solver;
        options.precision = CLBA_PRECISION_DOUBLE;
        options.function_tolerance = 1e-12;
        status = clba_problem_solve(problem, context, &options, &result);
    }
    if (status == CLBA_OK) status = clba_result_get_summary(result, summary);
    if (status != CLBA_OK) fprintf(stderr, "consumer: %s\n", clba_last_error());
    clba_result_release(result);
    clba_problem_release(problem);
    return status;
}

int main(void) {
    clba_context* context = NULL;
    clba_summary iterative, direct;
    clba_status status;
    double difference;
    if (clba_version() != CLBA_VERSION) {
        fprintf(stderr, "consumer: header %d, library %u\n", CLBA_VERSION,
                (unsigned)clba_version());
        return 1;
    }
    status = clba_context_create(NULL, &context);
    if (status != CLBA_OK) {
        fprintf(stderr, "consumer: %s\n", clba_last_error());
        return status == CLBA_ERROR_NO_DEVICE ? 77 : 1;
    }
    status = solve(context, CLBA_LINEAR_SOLVER_PCG_SCHUR, &iterative);
    if (status == CLBA_OK) status = solve(context, CLBA_LINEAR_SOLVER_DIRECT_SCHUR, &direct);
    clba_context_release(context);
    /* Without the plug-in, which is optional, the iterative solve is all there is. */
    if (status == CLBA_ERROR_NO_PLUGIN) return 0;
    if (status != CLBA_OK) return 1;
    difference = fabs(iterative.final_cost - direct.final_cost);
    printf("final cost %.9e, by direct_schur %.9e\n", iterative.final_cost, direct.final_cost);
    return difference <= 1e-6 * direct.final_cost ? 0 : 1;
}
