// SPDX-License-Identifier: Apache-2.0
// write_seeds PARSER FOLDER: the parser's seeds as files.
#include <cstdio>
#include <fstream>

#include "fuzz/parsers.hpp"

int main(int argc, char** argv) {
    if (argc != 3) {
        std::fprintf(stderr, "usage: write_seeds PARSER FOLDER\n");
        return 2;
    }
    int number = 0;
    for (const std::string& seed : clba::test::parser_named(argv[1]).seeds()) {
        std::ofstream file(std::string(argv[2]) + "/seed" + std::to_string(number++),
                           std::ios::binary);
        file << seed;
        if (!file.flush()) {
            std::fprintf(stderr, "cannot write to %s\n", argv[2]);
            return 1;
        }
    }
    return 0;
}
