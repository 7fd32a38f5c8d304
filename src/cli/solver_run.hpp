// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "cli/handles.hpp"

namespace cli {

// Solves with the log on standard output, unless quiet, and stops at the next iteration on Ctrl-C.
Result run_solver(clba_problem* problem, clba_context* context, clba_solver_options options,
                  bool quiet);

clba_summary summary_of(const clba_result* result);

}  // namespace cli
