/* SPDX-License-Identifier: Apache-2.0 */
/* Solves a BAL file, or without an argument a generated hall, and writes the result as PLY. */
#include <clba/clba.h>
#include <stdio.h>
#include <stdlib.h>

static void check(clba_status status) {
    if (status == CLBA_OK) return;
    fprintf(stderr, "%s: %s\n", clba_status_string(status), clba_last_error());
    exit(EXIT_FAILURE);
}

static int32_t print_row(const clba_iteration* row, void* user_data) {
    (void)user_data;
    printf("%3d  cost %.6e  gradient %.2e\n", row->iteration, row->cost, row->gradient_max_norm);
    return 0; /* anything else stops the solve */
}

int main(int argc, char** argv) {
    clba_problem* problem = NULL;
    if (argc > 1) {
        check(clba_problem_read_bal(argv[1], &problem));
    } else {
        clba_scene_options scene;
        check(clba_scene_options_init(&scene, sizeof scene));
        scene.scene = CLBA_SCENE_HALL;
        scene.num_images = 40;
        check(clba_problem_generate(&scene, &problem, NULL));
    }

    clba_context* context = NULL;
    check(clba_context_create(NULL, &context)); /* the best device */

    clba_solver_options options;
    check(clba_solver_options_init(&options, sizeof options));
    options.on_iteration = print_row;
    clba_result* result = NULL;
    check(clba_problem_solve(problem, context, &options, &result));
    printf("%s", clba_result_report(result));

    check(clba_problem_write_ply(problem, "quickstart.ply"));
    clba_result_release(result);
    clba_problem_release(problem);
    clba_context_release(context);
    return EXIT_SUCCESS;
}
