// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstddef>
#include <memory>
#include <string>
#include <string_view>

namespace clba {

// All of a regular file in memory.
class FileContent {
public:
    explicit FileContent(const std::string& path);
    std::string_view bytes() const { return {bytes_.get(), size_}; }
    const std::string& path() const { return path_; }

    // Of a position in the content, counted from 1.
    size_t line_at(const char* position) const;

private:
    std::string path_;
    std::unique_ptr<char[]> bytes_;
    size_t size_ = 0;
};

}  // namespace clba
