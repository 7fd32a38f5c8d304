// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "base/atomic_file.hpp"

namespace clba {

class Compressor;

// A text file written in blocks, compressed if its name ends in .gz or .bz2, that appears under its
// name only by commit().
class TextOutput {
public:
    explicit TextOutput(const std::string& path);
    ~TextOutput();
    TextOutput(const TextOutput&) = delete;
    TextOutput& operator=(const TextOutput&) = delete;

    void put(std::string_view characters);
    void put(int64_t value);
    void put(double value);  // the shortest digits that read back as the same double
    void commit();

private:
    void flush_block();

    AtomicFile file_;
    std::unique_ptr<Compressor> compressor_;  // null: plain
    std::string block_;
};

}  // namespace clba
