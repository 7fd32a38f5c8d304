// SPDX-License-Identifier: Apache-2.0
#include "io/number_reader.hpp"

#include <fast_float/fast_float.h>

#include <charconv>
#include <cmath>
#include <filesystem>

namespace clba {
namespace {

const char* without_plus(std::string_view token) {
    return token.data() + (token.size() > 1 && token[0] == '+' && token[1] != '-');
}

}  // namespace

bool parse_number(std::string_view token, double& value) {
    const char* const end = token.data() + token.size();
    return fast_float::from_chars(without_plus(token), end, value).ptr == end && !token.empty();
}

IntegerParse parse_integer(std::string_view token, int64_t& value) {
    const char* const end = token.data() + token.size();
    const auto [stop, error] = std::from_chars(without_plus(token), end, value);
    if (stop != end || error == std::errc::invalid_argument) return IntegerParse::no_integer;
    return error == std::errc() ? IntegerParse::ok : IntegerParse::too_large;
}

int64_t NumberReader::integer(const Field& field, int64_t least, int64_t most) {
    const std::string_view token = word(field);
    int64_t value = 0;
    if (!parse(token, field, value) || value < least || value > most)
        fail_here(field.words(), " = ", shown(token), ", but it must be from ", least, " to ",
                  most);
    return value;
}

int32_t NumberReader::index(const Field& field, const char* count_name, int32_t count) {
    const std::string_view token = word(field);
    int64_t value = 0;
    if (!parse(token, field, value) || value < 0 || value >= count)
        fail_here(field.row, " ", field.index, " has the ", field.name, " ", shown(token), ", but ",
                  count_name, " = ", count);
    return static_cast<int32_t>(value);
}

double NumberReader::number(const Field& field) {
    const std::string_view token = word(field);
    double value = 0;
    if (!parse_number(token, value))
        fail_here(field.words(), " is '", shown(token), "', but it must be a number");
    if (!std::isfinite(value))
        fail_here(field.words(), " is '", shown(token),
                  "', but it must be a finite double (below 1.8e308)");
    return value;
}

std::string_view NumberReader::word(const Field& field) {
    const std::string_view token = tokens_.next();
    if (token.empty()) {
        if (is_at_start_)
            fail(Status::format, tokens_.path(), " is empty, but ", format_, " begins with ",
                 start_);
        fail(Status::format, tokens_.path(), " ends at line ", tokens_.line(), " where ",
             field.words(), " was expected; it is truncated or its counts are wrong");
    }
    is_at_start_ = false;
    return token;
}

void NumberReader::expect(const Field& field, std::string_view expected) {
    const std::string_view token = word(field);
    if (token != expected)
        fail_here(field.words(), " is '", shown(token), "', but ", format_, " begins with ",
                  start_);
}

void NumberReader::expect_end(const char* last_row) {
    const std::string_view token = tokens_.next();
    if (!token.empty())
        fail_here("'", shown(token), "' follows ", last_row,
                  ", but the file must end there; check the counts in its first line");
}

bool NumberReader::parse(std::string_view token, const Field& field, int64_t& value) const {
    const IntegerParse result = parse_integer(token, value);
    if (result == IntegerParse::no_integer)
        fail_here(field.words(), " is '", shown(token), "', but it must be an integer");
    return result == IntegerParse::ok;
}

int64_t size_of_file(const std::string& path) {
    std::error_code error;
    const auto bytes = std::filesystem::file_size(path, error);
    return error ? 0 : static_cast<int64_t>(bytes);
}

}  // namespace clba
