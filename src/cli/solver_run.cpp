// SPDX-License-Identifier: Apache-2.0
#include "cli/solver_run.hpp"

#include <optional>

#include "cli/interrupt.hpp"
#include "cli/iteration_log.hpp"

namespace cli {
namespace {

int32_t on_iteration(const clba_iteration* row, void* user_data) {
    auto& log = *static_cast<std::optional<IterationLog>*>(user_data);
    if (log) log->print(*row);
    return interrupted();
}

}  // namespace

Result run_solver(clba_problem* problem, clba_context* context, clba_solver_options options,
                  bool quiet) {
    std::optional<IterationLog> log;
    if (!quiet) log.emplace(options.max_num_iterations);
    options.on_iteration = on_iteration;
    options.user_data = &log;
    const InterruptGuard guard;
    options.cancellation = guard.cancellation();
    clba_result* result = nullptr;
    check(clba_problem_solve(problem, context, &options, &result));
    return Result(result);
}

clba_summary summary_of(const clba_result* result) {
    clba_summary summary = {};
    summary.struct_size = sizeof summary;
    check(clba_result_get_summary(result, &summary));
    return summary;
}

}  // namespace cli
