// SPDX-License-Identifier: Apache-2.0
#include "io/bal_parallel.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <string_view>

#include "base/parallel.hpp"
#include "io/number_reader.hpp"
#include "io/read_progress.hpp"

namespace clba {
namespace {

using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;

constexpr size_t piece_bytes = size_t{1} << 18;

std::string_view take_token(std::string_view& text) {
    size_t begin = 0;
    while (begin < text.size() && is_space(text[begin])) ++begin;
    size_t end = begin;
    while (end < text.size() && !is_space(text[end])) ++end;
    const std::string_view token = text.substr(begin, end - begin);
    text.remove_prefix(end);
    return token;
}

int64_t count_tokens(std::string_view text) {
    int64_t count = 0;
    bool was_space = true;
    for (const char c : text) {
        const bool is_space_now = is_space(c);
        count += was_space && !is_space_now;
        was_space = is_space_now;
    }
    return count;
}

// Cuts a text that ends in white space, or at the end of the file, into pieces that do, too.
std::vector<std::string_view> pieces_of(std::string_view text) {
    std::vector<std::string_view> pieces;
    while (!text.empty()) {
        size_t size = std::min(piece_bytes, text.size());
        while (size < text.size() && !is_space(text[size])) ++size;
        pieces.push_back(text.substr(0, size));
        text.remove_prefix(size);
    }
    return pieces;
}

bool parse_index(std::string_view token, size_t count, int32_t& index) {
    int64_t value = 0;
    if (parse_integer(token, value) != IntegerParse::ok || value < 0 ||
        value >= static_cast<int64_t>(count))
        return false;
    index = static_cast<int32_t>(value);
    return true;
}

bool parse_finite(std::string_view token, double& value) {
    return parse_number(token, value) && std::isfinite(value);
}

// Puts numbers where they belong by how many came before them.
class Rows {
public:
    // False: the counts are wrong, or cannot be those of a file of so many bytes.
    bool begin(std::string_view& text, int64_t file_bytes, BalNumbers& numbers) {
        int64_t counts[3];
        for (int64_t& count : counts)
            if (parse_integer(take_token(text), count) != IntegerParse::ok || count < 0 ||
                count > std::min<int64_t>(file_bytes, std::numeric_limits<int32_t>::max()))
                return false;
        const auto [images, points, observations] = counts;
        end_of_observations_ = 4 * observations;
        end_of_images_ = end_of_observations_ + 9 * images;
        end_ = end_of_images_ + 3 * points;
        if (2 * end_ > file_bytes) return false;  // a digit and a space each
        numbers.observations.resize(static_cast<size_t>(observations));
        numbers.images.resize(static_cast<size_t>(images));
        numbers.points.resize(static_cast<size_t>(points));
        numbers_ = &numbers;
        return true;
    }

    int64_t size() const { return end_; }

    bool put(std::string_view token, int64_t place) {
        if (place < end_of_observations_) {
            Observation& row = numbers_->observations[static_cast<size_t>(place / 4)];
            switch (place % 4) {
                case 0:
                    return parse_index(token, numbers_->images.size(), row.image);
                case 1:
                    return parse_index(token, numbers_->points.size(), row.point);
                case 2:
                    return parse_finite(token, row.x);
                default:
                    return parse_finite(token, row.y);
            }
        }
        if (place < end_of_images_) {
            const auto k = static_cast<size_t>(place - end_of_observations_);
            return parse_finite(token, numbers_->images[k / 9][k % 9]);
        }
        if (place >= end_) return false;
        const auto k = static_cast<size_t>(place - end_of_images_);
        return parse_finite(token, numbers_->points[k / 3][k % 3]);
    }

private:
    BalNumbers* numbers_ = nullptr;
    int64_t end_of_observations_ = 0, end_of_images_ = 0, end_ = 0;  // in numbers
};

// Parses a window, whose first number is at `place`, and moves that on.
bool parse_window(std::string_view text, Rows& rows, int64_t& place) {
    const std::vector<std::string_view> pieces = pieces_of(text);
    std::vector<int64_t> places(pieces.size());
    const auto num_pieces = static_cast<int64_t>(pieces.size());
    parallel_for(num_pieces, [&](int64_t i, int) {
        places[static_cast<size_t>(i)] = count_tokens(pieces[static_cast<size_t>(i)]);
    });
    for (int64_t& of_piece : places) {
        const int64_t count = of_piece;
        of_piece = place;
        place += count;
    }
    std::atomic<bool> is_well_formed{true};
    parallel_for(num_pieces, [&](int64_t i, int) {
        std::string_view piece = pieces[static_cast<size_t>(i)];
        int64_t at = places[static_cast<size_t>(i)];
        for (std::string_view token = take_token(piece); !token.empty(); token = take_token(piece))
            if (!rows.put(token, at++)) {
                is_well_formed = false;
                return;
            }
    });
    return is_well_formed;
}

}  // namespace

bool read_bal_in_parallel(const std::string& path, size_t window_bytes, BalNumbers& numbers) {
    const File file(std::fopen(path.c_str(), "rb"), std::fclose);
    struct stat status {};
    if (!file || ::fstat(::fileno(file.get()), &status) != 0 || !S_ISREG(status.st_mode))
        return false;
    std::setvbuf(file.get(), nullptr, _IONBF, 0);
    const std::unique_ptr<char[]> window(new char[window_bytes]);
    Rows rows;
    int64_t place = 0;
    size_t rest = 0;  // bytes of the last window that no white space ends
    for (bool is_first = true;; is_first = false) {
        const size_t count = std::fread(window.get() + rest, 1, window_bytes - rest, file.get());
        const size_t size = rest + count;
        const bool is_last = size < window_bytes;
        size_t end = size;
        while (!is_last && end > 0 && !is_space(window[end - 1])) --end;
        std::string_view text(window.get(), end);
        if (std::ferror(file.get()) || (!is_last && end == 0) ||
            (is_first && !rows.begin(text, status.st_size, numbers)) ||
            !parse_window(text, rows, place))
            return false;
        ReadProgress::add(static_cast<int64_t>(count));
        if (is_last) return place == rows.size();
        rest = size - end;
        std::copy(window.get() + end, window.get() + size, window.get());
    }
}

}  // namespace clba
