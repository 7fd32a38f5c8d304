// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

namespace clba {

// Writes JSON text, indented by two spaces a level. A failing allocation throws from where it
// happens, which libraries that build a tree of values do not promise: their destructors allocate.
class JsonWriter {
public:
    void begin_object(std::string_view name = "") { open(name, '{'); }
    void end_object() { close('}'); }
    void begin_array(std::string_view name) { open(name, '['); }
    void end_array() { close(']'); }

    void add(std::string_view name, const char* value);  // bytes beyond ASCII become '?'
    void add(std::string_view name, double value);       // shortest digits; null if not finite
    void add(std::string_view name, bool value);
    void add(std::string_view name, int32_t value);
    void add(std::string_view name, int64_t value);
    void add(std::string_view name, uint64_t value);

    std::string take() { return std::move(text_); }

private:
    void open(std::string_view name, char bracket);
    void close(char bracket);
    void begin_value(std::string_view name);
    void append_string(std::string_view value);
    template <class Number>
    void append_number(std::string_view name, Number value);

    std::string text_;
    size_t depth_ = 0;
    bool is_first_ = true;  // of its object or array
};

}  // namespace clba
