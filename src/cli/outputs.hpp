// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

namespace cli {

struct Outputs {
    std::string problem;             // may be a folder, and may be the input
    std::vector<std::string> files;  // beside the problem
};

// Throws a Failure unless each path that is not empty can be written, as far as that is known
// before writing, and is no input and no other output: neither a long solve nor what it was made
// from must be lost to a name. other_inputs: beside the problem. The format of the problem is
// looked at by clba_problem_check_write.
void check_outputs(const Outputs& outputs, const std::string& problem_input = "",
                   const std::vector<std::string>& other_inputs = {});

// Written to a temporary beside the file and renamed: an error leaves what was there.
void write_text(const std::string& name, const std::string& text);

}  // namespace cli
