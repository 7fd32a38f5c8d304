// SPDX-License-Identifier: Apache-2.0
#include "io/json_document.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <vector>

#include "io/text_input.hpp"

namespace clba {
namespace {

constexpr size_t most_depth = 64;
constexpr size_t most_compared_members = 1000;

JsonObject& members_of(Json& object) {
    return object.get_ref<Json::object_t&>();
}

// Builds the document without looking up each key among those before it, as nlohmann's own builder
// does for objects that keep their order.
class Builder final : public nlohmann::json_sax<Json> {
public:
    Builder(const std::string& path, Json& root) : path_(path), root_(root) {}

    bool null() override { return add(nullptr); }
    bool boolean(bool value) override { return add(value); }
    bool number_integer(number_integer_t value) override { return add(value); }
    bool number_unsigned(number_unsigned_t value) override { return add(value); }
    bool number_float(number_float_t value, const string_t&) override { return add(value); }
    bool string(string_t& value) override { return add(std::move(value)); }
    bool binary(binary_t&) override { return false; }  // no such thing in a text
    bool start_object(size_t) override { return begin(Json::object()); }
    bool start_array(size_t) override { return begin(Json::array()); }
    bool end_array() override { return end(); }
    bool key(string_t& key) override {
        members_of(*open_.back()).emplace_back(std::move(key), nullptr);
        return true;
    }
    bool end_object() override {
        const JsonObject& members = members_of(*open_.back());
        if (members.size() <= most_compared_members) {
            keys_.clear();
            for (const auto& member : members) keys_.push_back(member.first);
            std::sort(keys_.begin(), keys_.end());
            const auto twice = std::adjacent_find(keys_.begin(), keys_.end());
            if (twice != keys_.end())
                fail(Status::format, path_, ": the key '", shown(*twice),
                     "' occurs twice in an object");
        }
        return end();
    }
    bool parse_error(size_t, const std::string&,
                     const nlohmann::detail::exception& error) override {
        const std::string_view message = error.what();
        const size_t after_number = message.find("] ");
        fail(Status::format, path_, " is not JSON: ",
             message.substr(after_number == std::string_view::npos ? 0 : after_number + 2));
    }

private:
    template <class Value>
    Json* place(Value&& value) {
        if (open_.empty()) return &(root_ = Json(std::forward<Value>(value)));
        Json& parent = *open_.back();
        if (parent.is_array()) {
            auto& entries = parent.get_ref<Json::array_t&>();
            entries.emplace_back(std::forward<Value>(value));
            return &entries.back();
        }
        return &(members_of(parent).back().second = Json(std::forward<Value>(value)));
    }
    template <class Value>
    bool add(Value&& value) {
        place(std::forward<Value>(value));
        return true;
    }
    bool begin(Json&& value) {
        if (open_.size() == most_depth)
            fail(Status::format, path_, ": values are nested more than ", most_depth, " deep");
        open_.push_back(place(std::move(value)));
        return true;
    }
    bool end() {
        open_.pop_back();
        return true;
    }

    const std::string& path_;
    Json& root_;
    std::vector<Json*> open_;
    std::vector<std::string_view> keys_;
};

}  // namespace

Json read_json(const std::string& path) {
    const std::string text = read_text(path);
    if (text.empty()) fail(Status::format, path, " is empty, but it must be a JSON document");
    Json root;
    Builder builder(path, root);
    Json::sax_parse(text.begin(), text.end(), &builder);
    return root;
}

const Json* JsonPlace::find(const char* key) const {
    for (const auto& [name, value] : members())
        if (name == key) return &value;
    return nullptr;
}

JsonPlace JsonPlace::operator[](const char* key) const& {
    const Json* const value = find(key);
    if (!value) fail_here("has no member '", key, "'");
    return {*this, *value, key, 0};
}

const JsonObject& JsonPlace::members() const {
    if (!value_->is_object()) fail_kind("an object");
    return value_->get_ref<const Json::object_t&>();
}

size_t JsonPlace::size() const {
    if (!value_->is_array()) fail_kind("an array");
    return value_->size();
}

void JsonPlace::expect_size(size_t expected) const {
    if (size() != expected) fail_here("has ", size(), " entries, but it must have ", expected);
}

double JsonPlace::number() const {
    if (!value_->is_number()) fail_kind("a number");
    return value_->get<double>();
}

int64_t JsonPlace::integer(int64_t least, int64_t most) const {
    if (!value_->is_number_integer()) fail_kind("an integer");
    const bool is_large =
        value_->is_number_unsigned() && value_->get<uint64_t>() > static_cast<uint64_t>(INT64_MAX);
    const int64_t value = is_large ? INT64_MAX : value_->get<int64_t>();
    if (is_large || value < least || value > most)
        fail_here("is ", value_->dump(), ", but it must be from ", least, " to ", most);
    return value;
}

const std::string& JsonPlace::string() const {
    if (!value_->is_string()) fail_kind("a string");
    return value_->get_ref<const std::string&>();
}

std::string JsonPlace::words() const {
    if (!parent_) return "the document";
    const std::string own = key_ ? shown(key_) : text("[", index_, "]");
    if (!parent_->parent_) return own;
    return parent_->words() + (key_ ? "." : "") + own;
}

void JsonPlace::fail_kind(const char* kind) const {
    fail_here("is ", value_->is_structured() ? value_->type_name() : shown(value_->dump()),
              ", but it must be ", kind);
}

void JsonOutput::begin(char bracket) {
    before_value();
    output_.put(std::string_view(&bracket, 1));
    brackets_ += bracket;
    is_first_ = true;
}

void JsonOutput::end() {
    const char bracket = brackets_.back() == '{' ? '}' : ']';
    brackets_.pop_back();
    if (!is_first_) new_line();
    output_.put(std::string_view(&bracket, 1));
    is_first_ = false;
}

JsonOutput& JsonOutput::key(std::string_view name) {
    before_value();
    put_quoted(name);
    output_.put(": ");
    is_after_key_ = true;
    return *this;
}

void JsonOutput::put(double value) {
    before_value();
    char digits[32];
    const auto end = std::to_chars(digits, digits + sizeof digits, value).ptr;
    const std::string_view number(digits, static_cast<size_t>(end - digits));
    output_.put(number);
    if (number.find_first_of(".e") == std::string_view::npos) output_.put(".0");
}

void JsonOutput::put(int64_t value) {
    before_value();
    output_.put(value);
}

void JsonOutput::put(std::string_view value) {
    before_value();
    put_quoted(value);
}

void JsonOutput::put(const Json& value) {
    switch (value.type()) {
        case Json::value_t::object:
            begin('{');
            for (const auto& [name, child] :
                 static_cast<const JsonObject&>(value.get_ref<const Json::object_t&>()))
                key(name).put(child);
            end();
            break;
        case Json::value_t::array:
            begin('[');
            for (const Json& child : value) put(child);
            end();
            break;
        case Json::value_t::number_float:
            put(value.get<double>());
            break;
        case Json::value_t::string:
            put(std::string_view(value.get_ref<const std::string&>()));
            break;
        default:
            before_value();
            output_.put(value.dump());
    }
}

void JsonOutput::before_value() {
    if (is_after_key_) {
        is_after_key_ = false;
        return;
    }
    if (brackets_.empty()) return;
    if (!is_first_) output_.put(",");
    is_first_ = false;
    new_line();
}

void JsonOutput::new_line() {
    output_.put("\n");
    for (size_t i = 0; i < brackets_.size(); ++i) output_.put("    ");
}

void JsonOutput::put_quoted(std::string_view value) {
    try {
        output_.put(Json(value).dump());
    } catch (const Json::type_error&) {
        fail(Status::invalid_argument, "'", shown(value),
             "' is not UTF-8, which all text in a JSON file must be; rename it");
    }
}

void set_member(Json& object, const char* key, Json value) {
    for (auto& member : members_of(object))
        if (member.first == key) {
            member.second = std::move(value);
            return;
        }
    members_of(object).emplace_back(key, std::move(value));
}

}  // namespace clba
