// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "clba/clba.h"

namespace cli {

// Priors from a text file: one a line, separated by commas: an index or an image's name, then x, y,
// z and their standard deviations. Empty lines, lines that begin with '#', and a first line that
// begins with a letter and no name are passed over. Throws a Failure that names the line.
// aligns: first moves the problem to where its centres fit the priors best.
void read_position_priors(const std::string& path, clba_problem* problem, bool aligns, bool quiet);
void read_point_priors(const std::string& path, clba_problem* problem);

}  // namespace cli
