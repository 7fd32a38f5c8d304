// SPDX-License-Identifier: Apache-2.0
#include "cli/verify.hpp"

#include <cstdio>

#include "cli/solver_run.hpp"

namespace cli {

nlohmann::ordered_json verify(const clba_problem* solved, const clba_summary& summary,
                              clba_problem* start, clba_context* context,
                              clba_solver_options options, bool quiet) {
    if (!quiet) std::printf("\nVerification by direct_schur in double precision\n\n");
    options.linear_solver = CLBA_LINEAR_SOLVER_DIRECT_SCHUR;
    options.preconditioner = CLBA_PRECONDITIONER_DEFAULT;
    options.precision = CLBA_PRECISION_DOUBLE;
    options.checkpoint_path = options.resume_path = nullptr;
    const Result result = run_solver(start, context, options, quiet);
    const clba_summary direct = summary_of(result.get());
    const double cost = summary.reference_final_cost;
    const double difference = cost - direct.reference_final_cost;
    const double relative_difference =
        difference == 0 ? 0 : difference / direct.reference_final_cost;

    clba_comparison comparison = {};
    comparison.struct_size = sizeof comparison;
    check(clba_problem_compare(start, solved, &comparison));
    if (!quiet) {
        std::printf("\n  cost of the solve          %.9e\n", cost);
        std::printf("  cost by direct_schur       %.9e\n", direct.reference_final_cost);
        std::printf("  relative difference        %.3e\n", relative_difference);
        std::printf("  largest differences after alignment, where camera centres spread %.6g\n",
                    comparison.extent);
        std::printf("  camera centres             %.3e, median %.3e\n",
                    comparison.max_center_distance, comparison.median_center_distance);
        std::printf("  points                     %.3e, median %.3e\n",
                    comparison.max_point_distance, comparison.median_point_distance);
        std::printf("  direct_schur ended with    %s\n", direct.message);
    }
    return {
        {"linear_solver", clba_linear_solver_name(direct.linear_solver)},
        {"precision", clba_precision_name(direct.precision)},
        {"converged", direct.termination == CLBA_CONVERGENCE},
        {"message", direct.message},
        {"num_iterations", direct.num_iterations},
        {"total_seconds", direct.total_seconds},
        {"reference_final_cost", direct.reference_final_cost},
        {"relative_cost_difference", relative_difference},
        {"extent", comparison.extent},
        {"scale", comparison.scale},
        {"max_center_distance", comparison.max_center_distance},
        {"median_center_distance", comparison.median_center_distance},
        {"max_point_distance", comparison.max_point_distance},
        {"median_point_distance", comparison.median_point_distance},
    };
}

}  // namespace cli
