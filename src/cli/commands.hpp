// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <CLI/CLI.hpp>

namespace cli {

// Each adds its command to the program. The command runs after parsing, as its callback, and stores
// what the program returns in `result` if that is not ok; it throws Failure on errors.
void add_devices(CLI::App& program);
void add_info(CLI::App& program);
void add_convert(CLI::App& program);
void add_generate(CLI::App& program);
void add_filter(CLI::App& program);
void add_solve(CLI::App& program, int& result);

}  // namespace cli
