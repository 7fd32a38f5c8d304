// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "clba/clba.h"

namespace cli {

struct CovarianceArguments {
    CovarianceArguments();
    clba_covariance_options options = {};
    std::string file;                     // "": none are wanted
    std::vector<int32_t> images, points;  // of the gauge; empty: chosen
    bool apply_variance_factor = false;
    bool all_points = false;
};

void add_covariance_options(CLI::App& command, CovarianceArguments& arguments);

// Writes the covariances at the problem's state, as JSON if the file's name ends in .json and as
// CSV otherwise, and prints a line about them unless quiet.
void write_covariances(clba_problem* problem, clba_context* context,
                       const CovarianceArguments& arguments, bool quiet);

}  // namespace cli
