// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <CLI/CLI.hpp>
#include <string>

#include "cli/handles.hpp"

namespace cli {

extern const char* const problem_help;  // what a FILE may be

// Of any format. Shows progress where standard error is a terminal, and, unless quiet, what the
// problem does not hold of the file.
Problem read_problem(const std::string& path, bool quiet);

struct Output {
    std::string path;
    int32_t format = CLBA_FORMAT_AUTO;
    bool accept_loss = false;
};
// An option of the given name for the format, and one to accept a loss.
void add_output_format(CLI::App& command, const std::string& name, Output& output);
void check_write(const clba_problem* problem, const Output& output);
void write_problem(const clba_problem* problem, const Output& output);

}  // namespace cli
