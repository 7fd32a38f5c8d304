// SPDX-License-Identifier: Apache-2.0
#include "cli/options.hpp"

#include <cmath>
#include <limits>
#include <map>

namespace cli {
namespace {

CLI::Validator number(bool (*rule)(double), const std::string& description) {
    return CLI::Validator(
        [rule, description](const std::string& text) {
            double value = std::numeric_limits<double>::quiet_NaN();
            const bool holds =
                CLI::detail::lexical_cast(text, value) && std::isfinite(value) && rule(value);
            return holds ? std::string() : text + " must be a " + description;
        },
        "");
}

}  // namespace

const CLI::Validator positive_number =
    number([](double value) { return value > 0; }, "finite number above 0");
const CLI::Validator non_negative_number =
    number([](double value) { return value >= 0; }, "finite number, 0 or above");
const CLI::Validator not_empty(
    [](const std::string& text) {
        return text.empty() ? "an empty text names no file" : std::string();
    },
    "");

CLI::Option* add_choice(CLI::App& command, const std::string& names, int32_t& value,
                        const char* (*name_of)(int32_t), const std::string& description) {
    constexpr int32_t first_unused = 32;  // above every enumeration of clba.h
    std::map<std::string, int32_t> values;
    for (int32_t candidate = 0; candidate < first_unused; ++candidate)
        if (const char* name = name_of(candidate)) values[name] = candidate;
    const char* current = name_of(value);
    CLI::Option* option = command.add_option_function<std::string>(
        names, [&value, values](const std::string& name) { value = values.at(name); }, description);
    option->check(CLI::IsMember(values));
    if (current) option->default_str(current);
    return option;
}

}  // namespace cli
