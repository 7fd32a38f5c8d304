// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <CLI/CLI.hpp>
#include <string>

#include "clba/clba.h"

namespace cli {

// An option whose values are the names that a clba_*_name function gives to the numbers from 0 up.
CLI::Option* add_choice(CLI::App& command, const std::string& names, int32_t& value,
                        const char* (*name_of)(int32_t), const std::string& description);

// Checks of an option's value: a finite number of that sign.
extern const CLI::Validator positive_number;
extern const CLI::Validator non_negative_number;
// A text that is not empty, as it is where a shell variable was not set.
extern const CLI::Validator not_empty;

}  // namespace cli
