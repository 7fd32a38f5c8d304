// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

namespace cli {

// Throws a Failure unless each path that is not empty can be written, as far as that is known
// before writing, and no two are the same: a long solve must not be lost to a missing folder.
// problem_path may be a folder; its format is looked at by clba_problem_check_write.
void check_outputs(const std::vector<std::string>& paths, const std::string& problem_path = "");

// Written to a temporary beside the file and renamed: an error leaves what was there.
void write_text(const std::string& name, const std::string& text);

}  // namespace cli
