// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "base/error.hpp"
#include "io/text_output.hpp"

namespace clba {

using Json = nlohmann::ordered_json;
using JsonObject = Json::object_t::Container;  // members as pairs, in the order of the file

// A whole document; plain, gzip or bzip2. Values may be nested 64 deep. A key may occur once in an
// object of up to 1000 members.
Json read_json(const std::string& path);

// A value in a document and the way to it, for errors: "path: structure[3].value.X: ...". It refers
// to the value it was reached from.
class JsonPlace {
public:
    JsonPlace(const std::string& path, const Json& root) : path_(&path), value_(&root) {}

    const Json& value() const { return *value_; }
    bool is_null() const { return value_->is_null(); }

    const Json* find(const char* key) const;  // null: no such member
    JsonPlace operator[](const char* key) const&;
    JsonPlace operator[](const char* key) && = delete;  // a place refers to the one it comes from
    JsonPlace at(size_t index) const& { return {*this, (*value_)[index], nullptr, index}; }
    JsonPlace at(size_t index) && = delete;
    JsonPlace member(size_t index) const& {
        const auto& [key, value] = members()[index];
        return {*this, value, key.c_str(), 0};
    }
    JsonPlace member(size_t index) && = delete;

    const JsonObject& members() const;  // an error if it is no object
    size_t size() const;                // an error if it is no array
    void expect_size(size_t size) const;
    double number() const;
    int64_t integer(int64_t least, int64_t most) const;
    const std::string& string() const;
    template <size_t n>
    std::array<double, n> numbers() const {
        expect_size(n);
        std::array<double, n> values;
        for (size_t k = 0; k < n; ++k) values[k] = at(k).number();
        return values;
    }

    template <class... Parts>
    [[noreturn]] void fail_here(const Parts&... parts) const {
        fail(Status::format, *path_, ": ", words(), ": ", parts...);
    }

private:
    JsonPlace(const JsonPlace& parent, const Json& value, const char* key, size_t index)
        : path_(parent.path_), parent_(&parent), value_(&value), key_(key), index_(index) {}
    std::string words() const;
    [[noreturn]] void fail_kind(const char* kind) const;

    const std::string* path_;
    const JsonPlace* parent_ = nullptr;
    const Json* value_;
    const char* key_ = nullptr;  // null: an array's entry
    size_t index_ = 0;
};

// Writes a document piece by piece, indented by 4.
class JsonOutput {
public:
    explicit JsonOutput(TextOutput& output) : output_(output) {}

    void begin(char bracket);  // '{' or '['
    void end();
    JsonOutput& key(std::string_view name);
    void put(double value);
    void put(int64_t value);
    void put(std::string_view text);
    void put(const Json& value);
    template <size_t n>
    void put(const std::array<double, n>& values) {
        begin('[');
        for (double value : values) put(value);
        end();
    }

private:
    void before_value();
    void new_line();
    void put_quoted(std::string_view text);

    TextOutput& output_;
    std::string brackets_;  // those open
    bool is_first_ = true, is_after_key_ = false;
};

// Sets a member, keeping its place where it exists.
void set_member(Json& object, const char* key, Json value);

}  // namespace clba
