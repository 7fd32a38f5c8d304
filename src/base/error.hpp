// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>

namespace clba {

// The numbers of clba_status; src/api checks at compile time that the two agree.
enum class Status : int {
    ok = 0,
    invalid_argument = -1,
    out_of_memory = -2,
    no_device = -3,
    kernel_build = -4,
    device = -5,
    internal = -6,
    file = -7,
    format = -8,
    no_plugin = -9,
    cancelled = -10
};

// Thrown everywhere inside the library and turned into a status by src/api. The message gives the
// value, the rule it breaks and, where it is not obvious, the remedy.
class Error : public std::runtime_error {
public:
    Error(Status status, const std::string& message)
        : std::runtime_error(message), status_(status) {}
    Status status() const { return status_; }

private:
    Status status_;
};

// Joins its arguments as a stream would, doubles with up to 10 digits.
template <class... Parts>
std::string text(const Parts&... parts) {
    std::ostringstream stream;
    stream.exceptions(std::ios::badbit);  // without memory a stream would silently cut the text
    stream.precision(10);
    (stream << ... << parts);
    return stream.str();
}

template <class... Parts>
[[noreturn]] void fail(Status status, const Parts&... parts) {
    throw Error(status, text(parts...));
}

// Throws an invalid_argument error unless the rule holds.
template <class... Parts>
void require(bool rule, const Parts&... parts) {
    if (!rule) fail(Status::invalid_argument, parts...);
}

}  // namespace clba
