// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// The numbers of a BAL file.
struct BalNumbers {
    std::vector<Observation> observations;
    std::vector<std::array<double, 9>> images;
    std::vector<Point> points;
};

// Reads a plain BAL file by all threads, so many bytes at a time. False: it is compressed, no
// regular file, or not as it should be; numbers are not to be used then, and reading it number by
// number tells what is wrong.
bool read_bal_in_parallel(const std::string& path, size_t window_bytes, BalNumbers& numbers);

}  // namespace clba
