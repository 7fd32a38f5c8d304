// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace clba {

// A file's bytes in order, decompressed where the file begins like a gzip or bzip2 one (of any
// number of members). Errors are Status::file for the system's and Status::format for compressed
// data that are damaged or end early.
class ByteSource {
public:
    virtual ~ByteSource() = default;
    virtual size_t read(char* bytes, size_t size) = 0;  // less than size only at the end
};
std::unique_ptr<ByteSource> open_input(const std::string& path);

// Splits a text at white space, holding one block of it at a time.
class TokenReader {
public:
    explicit TokenReader(const std::string& path);
    std::string_view next();                      // empty at the end; valid until the next call
    std::string rest();                           // all that follows the token last returned
    int64_t line() const { return token_line_; }  // of the token last returned, counted from 1
    const std::string& path() const { return path_; }

private:
    bool refill();

    std::string path_;
    std::unique_ptr<ByteSource> source_;
    std::vector<char> block_;
    size_t begin_ = 0, end_ = 0;  // the part of block_ not yet returned
    int64_t line_ = 1, token_line_ = 1;
};

// Splits a text into lines.
class LineReader {
public:
    explicit LineReader(const std::string& path);
    // False at the end. The line comes without its end, "\n" or "\r\n"; valid until the next call.
    bool next(std::string_view& line);
    int64_t line() const { return line_; }  // of the line last returned, counted from 1
    const std::string& path() const { return path_; }

private:
    std::string path_;
    std::unique_ptr<ByteSource> source_;
    std::vector<char> block_;
    size_t begin_ = 0, end_ = 0;  // the part of block_ not yet returned
    int64_t line_ = 0;
};

// All of a file.
std::string read_text(const std::string& path);

inline bool is_space(char c) {
    return c == ' ' || (c >= '\t' && c <= '\r');
}

// A token for an error message: its first characters, unprintable ones replaced by '?'.
std::string shown(std::string_view token);

}  // namespace clba
