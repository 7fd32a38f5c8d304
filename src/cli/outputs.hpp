// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

namespace cli {

// Throws a Failure unless each path that is not empty can be written, as far as that is known
// before writing, and no two are the same: a long solve must not be lost to a missing folder.
void check_outputs(const std::vector<std::string>& paths);

// Written to a temporary beside the file and renamed: an error leaves what was there.
void write_text(const std::string& name, const std::string& text);

}  // namespace cli
