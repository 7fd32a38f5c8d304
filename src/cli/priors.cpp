// SPDX-License-Identifier: Apache-2.0
#include "cli/priors.hpp"

#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <fstream>
#include <string_view>
#include <vector>

#include "cli/exit_code.hpp"

namespace cli {
namespace {

struct Rows {
    std::vector<int32_t> indices;
    std::vector<std::array<double, 3>> positions;
    std::vector<std::array<double, 9>> covariances;
};

std::string_view trimmed(std::string_view text) {
    const size_t begin = text.find_first_not_of(" \t\r");
    if (begin == std::string_view::npos) return {};
    return text.substr(begin, text.find_last_not_of(" \t\r") - begin + 1);
}

template <class Number>
bool parse(std::string_view text, Number& value) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    return error == std::errc() && end == text.data() + text.size();
}

// The next field, and what follows its comma; false: there was none.
bool take_field(std::string_view& rest, bool& has_more, std::string_view& field) {
    if (!has_more) return false;
    const size_t comma = rest.find(',');
    has_more = comma != std::string_view::npos;
    field = trimmed(rest.substr(0, comma));
    rest = has_more ? rest.substr(comma + 1) : std::string_view();
    return true;
}

Rows read_rows(const std::string& path) {
    constexpr const char* names[] = {"x", "y", "z", "sx", "sy", "sz"};
    std::ifstream file(path);
    if (!file) throw Failure(ExitCode::file, path + ": cannot be opened");
    Rows rows;
    std::string line;
    for (int64_t number = 1; std::getline(file, line); ++number) {
        std::string_view rest = trimmed(line);
        if (rest.empty() || rest[0] == '#') continue;
        if (number == 1 && std::isalpha(static_cast<unsigned char>(rest[0]))) continue;
        const auto refuse = [&](const std::string& what) {
            throw Failure(ExitCode::file, path + ":" + std::to_string(number) + ": " + what);
        };
        bool has_more = true;
        std::string_view field;
        int32_t index = -1;
        if (!take_field(rest, has_more, field) || !parse(field, index))
            refuse("the index is '" + std::string(field.substr(0, 40)) +
                   "', but it must be an integer");
        std::array<double, 6> values{};
        for (size_t k = 0; k < values.size(); ++k) {
            if (!take_field(rest, has_more, field))
                refuse(std::string("there is no ") + names[k] +
                       ", but a line has index, x, y, z, sx, sy, sz");
            if (!parse(field, values[k]) || !std::isfinite(values[k]))
                refuse(std::string(names[k]) + " is '" + std::string(field.substr(0, 40)) +
                       "', but it must be a finite number");
            if (k >= 3 && !(values[k] > 0))
                refuse(std::string(names[k]) + " is '" + std::string(field.substr(0, 40)) +
                       "', but a standard deviation is > 0");
        }
        if (has_more) refuse("there is more than index, x, y, z, sx, sy, sz");
        rows.indices.push_back(index);
        rows.positions.push_back({values[0], values[1], values[2]});
        rows.covariances.push_back({values[3] * values[3], 0, 0, 0, values[4] * values[4], 0, 0, 0,
                                    values[5] * values[5]});
    }
    if (file.bad()) throw Failure(ExitCode::file, path + ": cannot be read");
    if (rows.indices.empty()) throw Failure(ExitCode::file, path + ": has no priors");
    return rows;
}

template <class Set>
void read_priors(const std::string& path, clba_problem* problem, Set&& set) {
    const Rows rows = read_rows(path);
    const clba_status status =
        set(problem, static_cast<int32_t>(rows.indices.size()), rows.indices.data(), 0,
            rows.positions.front().data(), 0, rows.covariances.front().data(), 0);
    if (status != CLBA_OK) throw Failure(ExitCode::file, path + ": " + clba_last_error());
}

}  // namespace

void read_position_priors(const std::string& path, clba_problem* problem) {
    read_priors(path, problem, clba_problem_set_position_priors);
}

void read_point_priors(const std::string& path, clba_problem* problem) {
    read_priors(path, problem, clba_problem_set_point_priors);
}

}  // namespace cli
