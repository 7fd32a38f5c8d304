// SPDX-License-Identifier: Apache-2.0
#include "io/opensfm_tracks.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>
#include <unordered_map>

#include "base/error.hpp"
#include "io/number_reader.hpp"
#include "io/text_input.hpp"

namespace clba {
namespace {

constexpr std::string_view header = "OPENSFM_TRACKS_VERSION_v";
constexpr size_t num_columns[] = {8, 9, 11};

class RowReader {
public:
    RowReader(const LineReader& lines, std::string_view line) : lines_(lines), rest_(line) {}

    std::string_view text() {
        const size_t tab = rest_.find('\t');
        const std::string_view field = rest_.substr(0, tab);
        rest_.remove_prefix(tab == std::string_view::npos ? rest_.size() : tab + 1);
        return field;
    }
    int32_t integer(const char* name) {
        const std::string_view field = text();
        int64_t value = 0;
        if (parse_integer(field, value) != IntegerParse::ok ||
            value < std::numeric_limits<int32_t>::min() ||
            value > std::numeric_limits<int32_t>::max())
            fail_here("the ", name, " is '", shown(field),
                      "', but it must be an integer of 32 bits");
        return static_cast<int32_t>(value);
    }
    double number(const char* name) {
        const std::string_view field = text();
        double value = 0;
        if (!parse_number(field, value) || !std::isfinite(value))
            fail_here("the ", name, " is '", shown(field), "', but it must be a finite number");
        return value;
    }

    template <class... Parts>
    [[noreturn]] void fail_here(const Parts&... parts) const {
        fail(Status::format, lines_.path(), ":", lines_.line(), ": ", parts...);
    }

private:
    const LineReader& lines_;
    std::string_view rest_;
};

class Names {
public:
    explicit Names(std::vector<std::string>& names) : names_(names) {}
    int32_t index(std::string_view name) {
        const auto [entry, is_new] =
            indices_.emplace(std::string(name), static_cast<int32_t>(names_.size()));
        if (is_new) names_.emplace_back(name);
        return entry->second;
    }

private:
    std::vector<std::string>& names_;
    std::unordered_map<std::string, int32_t> indices_;
};

}  // namespace

OpenSfmTracks read_opensfm_tracks(const std::string& path) {
    OpenSfmTracks tracks;
    tracks.version = 0;
    tracks.has_header = false;
    Names images(tracks.images), names(tracks.tracks);
    LineReader lines(path);
    for (std::string_view line; lines.next(line);) {
        RowReader row(lines, line);
        if (lines.line() == 1 && line.substr(0, header.size()) == header) {
            int64_t version = -1;
            if (parse_integer(line.substr(header.size()), version) != IntegerParse::ok ||
                version < 0 || version > 2)
                row.fail_here("the version of the tracks is '", shown(line.substr(header.size())),
                              "', but only v0, v1 and v2 can be read");
            tracks.version = static_cast<int>(version);
            tracks.has_header = true;
            continue;
        }
        const size_t columns = 1 + static_cast<size_t>(std::count(line.begin(), line.end(), '\t'));
        if (columns != num_columns[tracks.version])
            row.fail_here("the line has ", columns, " columns with tabs between them, but version ",
                          tracks.version, " of the tracks has ", num_columns[tracks.version]);
        OpenSfmTrackRow read;
        read.image = images.index(row.text());
        read.track = names.index(row.text());
        read.feature = row.integer("feature");
        read.x = row.number("x");
        read.y = row.number("y");
        if (tracks.version >= 1) read.scale = row.number("scale");
        for (int32_t& value : read.color) value = row.integer("colour");
        if (tracks.version >= 2) {
            read.segmentation = row.integer("segmentation");
            read.instance = row.integer("instance");
        }
        tracks.rows.push_back(read);
    }
    return tracks;
}

void put_opensfm_tracks(TextOutput& output, const OpenSfmTracks& tracks) {
    if (tracks.has_header) {
        output.put(header);
        output.put(int64_t{tracks.version});
        output.put("\n");
    }
    for (const OpenSfmTrackRow& row : tracks.rows) {
        const auto put = [&output](auto value) {
            output.put("\t");
            output.put(value);
        };
        output.put(tracks.images[row.image]);
        put(std::string_view(tracks.tracks[row.track]));
        put(int64_t{row.feature});
        put(row.x);
        put(row.y);
        if (tracks.version >= 1) put(row.scale);
        for (int32_t value : row.color) put(int64_t{value});
        if (tracks.version >= 2) {
            put(int64_t{row.segmentation});
            put(int64_t{row.instance});
        }
        output.put("\n");
    }
}

}  // namespace clba
