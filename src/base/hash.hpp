// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <cstring>
#include <string_view>

namespace clba {

// A 64-bit hash of a sequence of words, for telling damaged or different data apart; not against
// forgery. Each word goes through a bijection of the state, so that a change of one word always
// shows.
class Hash {
public:
    void add(uint64_t word) {
        constexpr uint64_t odd = 0x9e3779b97f4a7c15;  // 2^64 / golden ratio
        value_ = (value_ ^ word) * odd;
        value_ ^= value_ >> 32;
    }
    void add(double value) {
        uint64_t word;
        std::memcpy(&word, &value, sizeof word);
        add(word);
    }
    void add_bytes(std::string_view bytes) {
        for (size_t i = 0; i < bytes.size(); i += 8) {
            uint64_t word = 0;
            for (size_t k = i; k < bytes.size() && k < i + 8; ++k)
                word |= uint64_t{static_cast<unsigned char>(bytes[k])} << (8 * (k - i));
            add(word);
        }
        add(uint64_t{bytes.size()});
    }
    uint64_t value() const { return value_; }

private:
    uint64_t value_ = 0;
};

}  // namespace clba
