// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <string_view>
#include <vector>

namespace clba::test {

// A format's reader and writer as fuzzers see them.
struct Parser {
    const char* name;
    std::vector<std::string> files;  // names of the files it reads, the main one first
    std::string main;  // what is named to the reader: a file of these, or "" for their folder
    bool is_exact;     // what is read after it was written is written as the same bytes
    void (*read_and_write)(const std::string& input, const std::string& output);
    std::vector<std::string> (*seeds)();
};

const std::vector<Parser>& parsers();
const Parser& parser_named(std::string_view name);

// Between the contents of a parser's files in one input.
extern const std::string_view separator;

// Reads the input. False: refused with an error of the kinds that files may cause. Otherwise what
// was read must be valid, and writing it, reading that and writing it again must work, and give
// equal bytes if is_exact. Whatever else happens ends the process.
bool accepts(const Parser& parser, std::string_view input);

}  // namespace clba::test
