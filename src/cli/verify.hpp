// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <nlohmann/json.hpp>

#include "cli/handles.hpp"

namespace cli {

// Solves `start`, the same problem from the same start, by direct_schur in double precision with
// the other options as they are, and prints how far its result is from `solved`, which a solve
// with `summary` left. Returns what it found, for the JSON summary.
nlohmann::ordered_json verify(const clba_problem* solved, const clba_summary& summary,
                              clba_problem* start, clba_context* context,
                              clba_solver_options options, bool quiet);

}  // namespace cli
