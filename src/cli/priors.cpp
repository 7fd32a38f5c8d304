// SPDX-License-Identifier: Apache-2.0
#include "cli/priors.hpp"

#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <map>
#include <string_view>
#include <vector>

#include "cli/handles.hpp"

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

// What priors are of.
struct Subjects {
    const char* kind;  // "image"
    int32_t count;
    std::map<std::string, int32_t, std::less<>> indices;  // of names; -1: several have it
};

Subjects images_of(const clba_problem* problem) {
    Subjects images{"image", info_of(problem).num_images, {}};
    for (int32_t i = 0; i < images.count; ++i) {
        const char* name = clba_problem_get_image_name(problem, i);
        if (!*name) continue;
        const auto [place, is_new] = images.indices.emplace(name, i);
        if (!is_new) place->second = -1;
    }
    return images;
}

Rows read_rows(const std::string& path, const Subjects& subjects) {
    constexpr const char* names[] = {"x", "y", "z", "sx", "sy", "sz"};
    std::ifstream file(path);
    if (!file) throw Failure(ExitCode::file, path + ": cannot be opened");
    Rows rows;
    std::string line;
    for (int64_t number = 1; std::getline(file, line); ++number) {
        std::string_view rest = trimmed(line);
        constexpr std::string_view byte_order_mark = "\xef\xbb\xbf";
        if (number == 1 && rest.substr(0, byte_order_mark.size()) == byte_order_mark)
            rest.remove_prefix(byte_order_mark.size());
        if (rest.empty() || rest[0] == '#') continue;
        const auto refuse = [&](const std::string& what) {
            throw Failure(ExitCode::file, path + ":" + std::to_string(number) + ": " + what);
        };
        bool has_more = true;
        std::string_view field;
        int32_t index = -1;
        take_field(rest, has_more, field);
        if (!parse(field, index)) {
            const auto named = subjects.indices.find(field);
            if (named == subjects.indices.end()) {
                if (number == 1 && !field.empty() &&
                    std::isalpha(static_cast<unsigned char>(field[0])))
                    continue;
                refuse("the " + std::string(subjects.kind) + " is '" +
                       std::string(field.substr(0, 40)) + "', but it must be an index" +
                       (subjects.indices.empty() ? "" : ", or a name in the problem"));
            }
            index = named->second;
            if (index < 0)
                refuse("several images have the name '" + std::string(field) +
                       "'; give the index instead");
        } else if (index < 0 || index >= subjects.count) {
            refuse("the index is " + std::to_string(index) + ", but there are " +
                   std::to_string(subjects.count) + " " + subjects.kind + "s, counted from 0");
        }
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
void set_priors(const std::string& path, const Rows& rows, clba_problem* problem, Set&& set) {
    const clba_status status =
        set(problem, static_cast<int32_t>(rows.indices.size()), rows.indices.data(), 0,
            rows.positions.front().data(), 0, rows.covariances.front().data(), 0);
    if (status != CLBA_OK) throw Failure(ExitCode::file, path + ": " + clba_last_error());
}

void align(const std::string& path, const Rows& rows, clba_problem* problem) {
    std::vector<double> centers(3 * static_cast<size_t>(info_of(problem).num_images),
                                std::numeric_limits<double>::quiet_NaN());
    for (size_t i = 0; i < rows.indices.size(); ++i)
        for (size_t k = 0; k < 3; ++k)
            centers[3 * static_cast<size_t>(rows.indices[i]) + k] = rows.positions[i][k];
    clba_gauge_target target = {};
    check(clba_gauge_target_init(&target, sizeof target));
    target.gauge = CLBA_GAUGE_INNER;
    target.centers = centers.data();
    if (clba_problem_fix_gauge(problem, &target) != CLBA_OK)
        throw Failure(ExitCode::usage,
                      path + ": cannot align the problem to these: " + clba_last_error());
}

// Root mean square of the distances of centres from their priors, in standard deviations.
double misfit(const Rows& rows, const clba_problem* problem) {
    double sum = 0;
    for (size_t i = 0; i < rows.indices.size(); ++i) {
        double center[3];
        check(clba_problem_get_centers(problem, rows.indices[i], 1, center, 0));
        for (size_t k = 0; k < 3; ++k) {
            const double difference = center[k] - rows.positions[i][k];
            sum += difference * difference / rows.covariances[i][4 * k];
        }
    }
    return std::sqrt(sum / (3 * static_cast<double>(rows.indices.size())));
}

}  // namespace

void read_position_priors(const std::string& path, clba_problem* problem, bool aligns, bool quiet) {
    constexpr double another_frame = 100;  // standard deviations
    const Rows rows = read_rows(path, images_of(problem));
    if (aligns) align(path, rows, problem);
    const double distance = misfit(rows, problem);
    if (!quiet && distance > another_frame)
        std::fprintf(stderr,
                     "clba: note: %s: camera centres are %.3g standard deviations away from their "
                     "priors%s\n",
                     path.c_str(), distance,
                     aligns ? ", after the alignment, too"
                            : "; if these are of another frame, use --align-to-priors");
    set_priors(path, rows, problem, clba_problem_set_position_priors);
}

void read_point_priors(const std::string& path, clba_problem* problem) {
    const Subjects points{"point", info_of(problem).num_points, {}};
    set_priors(path, read_rows(path, points), problem, clba_problem_set_point_priors);
}

}  // namespace cli
