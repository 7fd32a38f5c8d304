// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "cli/handles.hpp"

namespace cli {

clba_filter_options filter_defaults();

// Options of the rules: --max-error, ..., or --filter-max-error, ... with the prefix "filter-".
void add_filter_options(CLI::App& command, clba_filter_options& options, const std::string& prefix);

clba_filter_report filter(clba_problem* problem, const clba_filter_options& options);

void print_filter_report(const clba_filter_report& report);
nlohmann::ordered_json filter_json(const clba_filter_report& report);

}  // namespace cli
