/* SPDX-License-Identifier: Apache-2.0 */
/* Solves a BAL file in two goes: a callback stops the first, the second runs to the end.
 *
 *     cc -std=c99 solve.c $(pkg-config --cflags --libs clba) -o solve && ./solve FILE */
#include <clba/clba.h>
#include <stdio.h>
#include <stdlib.h>

static void check(clba_status status) {
    if (status == CLBA_OK) return;
    fprintf(stderr, "%s: %s\n", clba_status_string(status), clba_last_error());
    exit(EXIT_FAILURE);
}

/* user_data: the iteration to stop after, or NULL. */
static int32_t print_row(const clba_iteration* row, void* user_data) {
    const int32_t* last = user_data;
    printf("%3d  cost %.6e\n", (int)row->iteration, row->cost);
    return last && row->iteration == *last;
}

static clba_result* solve(clba_problem* problem, clba_context* context, int32_t* last) {
    clba_solver_options options;
    check(clba_solver_options_init(&options, sizeof options));
    options.on_iteration = print_row;
    options.user_data = last;
    clba_result* result = NULL;
    check(clba_problem_solve(problem, context, &options, &result));
    return result;
}

static clba_summary summary_of(const clba_result* result) {
    clba_summary summary;
    summary.struct_size = sizeof summary;
    check(clba_result_get_summary(result, &summary));
    return summary;
}

int main(int argc, char** argv) {
    if (argc != 2) {
        fprintf(stderr, "usage: solve FILE\n");
        return EXIT_FAILURE;
    }
    clba_problem* problem = NULL;
    clba_context* context = NULL;
    check(clba_problem_read_bal(argv[1], &problem));
    check(clba_context_create(NULL, &context));

    int32_t last = 3;
    clba_result* stopped = solve(problem, context, &last);
    const clba_summary half_way = summary_of(stopped);
    if (half_way.termination != CLBA_USER_STOP) {
        fprintf(stderr, "not stopped by the callback: %s\n", half_way.message);
        return EXIT_FAILURE;
    }
    printf("stopped at %.16e\n", half_way.final_cost);

    /* It goes on from the state that the first solve left. */
    clba_result* result = solve(problem, context, NULL);
    printf("%s", clba_result_report(result));
    printf("final cost %.16e\n", summary_of(result).final_cost);

    clba_result_release(result);
    clba_result_release(stopped);
    clba_context_release(context);
    clba_problem_release(problem);
    return EXIT_SUCCESS;
}
