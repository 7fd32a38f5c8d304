// SPDX-License-Identifier: Apache-2.0
#include "api/json_writer.hpp"

#include <charconv>
#include <cmath>
#include <cstdio>

namespace clba {

void JsonWriter::begin_value(std::string_view name) {
    if (depth_ > 0) {
        text_ += is_first_ ? "\n" : ",\n";
        text_.append(2 * depth_, ' ');
    }
    is_first_ = false;
    if (name.empty()) return;
    append_string(name);
    text_ += ": ";
}

void JsonWriter::open(std::string_view name, char bracket) {
    begin_value(name);
    text_ += bracket;
    ++depth_;
    is_first_ = true;
}

void JsonWriter::close(char bracket) {
    --depth_;
    if (!is_first_) {
        text_ += '\n';
        text_.append(2 * depth_, ' ');
    }
    text_ += bracket;
    is_first_ = false;
}

void JsonWriter::append_string(std::string_view value) {
    text_ += '"';
    for (const char c : value) {
        const auto byte = static_cast<unsigned char>(c);
        if (c == '"' || c == '\\') {
            text_ += '\\';
            text_ += c;
        } else if (byte < 0x20) {
            char escaped[8];
            std::snprintf(escaped, sizeof escaped, "\\u%04x", byte);
            text_ += escaped;
        } else {
            text_ += byte < 0x7f ? c : '?';
        }
    }
    text_ += '"';
}

template <class Number>
void JsonWriter::append_number(std::string_view name, Number value) {
    begin_value(name);
    char digits[32];  // the longest double has 24
    text_.append(digits, std::to_chars(digits, digits + sizeof digits, value).ptr);
}

void JsonWriter::add(std::string_view name, const char* value) {
    begin_value(name);
    append_string(value);
}

void JsonWriter::add(std::string_view name, double value) {
    if (std::isfinite(value)) return append_number(name, value);
    begin_value(name);
    text_ += "null";
}

void JsonWriter::add(std::string_view name, bool value) {
    begin_value(name);
    text_ += value ? "true" : "false";
}

void JsonWriter::add(std::string_view name, int32_t value) {
    append_number(name, value);
}

void JsonWriter::add(std::string_view name, int64_t value) {
    append_number(name, value);
}

void JsonWriter::add(std::string_view name, uint64_t value) {
    append_number(name, value);
}

}  // namespace clba
