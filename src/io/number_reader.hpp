// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <cstdint>
#include <string>
#include <string_view>

#include "base/error.hpp"
#include "io/text_input.hpp"

namespace clba {

// Whether the whole token is a number; a plus sign may lead. What overflows becomes infinite.
bool parse_number(std::string_view token, double& value);

enum class IntegerParse { ok, no_integer, too_large };
IntegerParse parse_integer(std::string_view token, int64_t& value);

// What a token stands for, put into words only when an error needs them.
struct Field {
    const char* name;
    const char* row = nullptr;  // null: the header
    int64_t index = 0;
    int64_t num_rows = 0;

    std::string words() const {
        return row ? text("the ", name, " of ", row, " ", index, " of ", num_rows) : name;
    }
};

// Reads a text of numbers and words that white space separates. Errors are Status::format and give
// file, line, value and rule.
class NumberReader {
public:
    // format: "a BAL file"; start: what such a file begins with.
    NumberReader(const std::string& path, const char* format, const char* start)
        : tokens_(path), format_(format), start_(start) {}

    int64_t count(const Field& field, int64_t most) { return integer(field, 0, most); }
    int64_t integer(const Field& field, int64_t least, int64_t most);
    // Of one of `count` rows, which the file counts as count_name.
    int32_t index(const Field& field, const char* count_name, int32_t count);
    double number(const Field& field);
    std::string_view word(const Field& field);  // valid until the next call
    void expect(const Field& field, std::string_view word);
    void expect_end(const char* last_row);
    std::string rest() { return tokens_.rest(); }

    const std::string& path() const { return tokens_.path(); }

    template <class... Parts>
    [[noreturn]] void fail_here(const Parts&... parts) const {
        fail(Status::format, tokens_.path(), ":", tokens_.line(), ": ", parts...);
    }

private:
    // False: an integer, but too large for an int64_t.
    bool parse(std::string_view token, const Field& field, int64_t& value) const;

    TokenReader tokens_;
    const char* format_;
    const char* start_;
    bool is_at_start_ = true;
};

// Room for the rows that a header promises, as far as the file is large enough to hold them: a
// wrong header must not decide how much memory is asked for.
template <class Rows>
void reserve(Rows& rows, int64_t count, int64_t file_bytes, int64_t least_bytes_per_row) {
    rows.reserve(static_cast<size_t>(std::min(count, file_bytes / least_bytes_per_row)));
}

int64_t size_of_file(const std::string& path);  // 0: a pipe

}  // namespace clba
