// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>

#include "problem/problem.hpp"

namespace clba {

// Of everything but the state: structure, measurements, weights, constants and the loss. Problems
// of different fingerprints differ; the reverse holds but by chance.
uint64_t fingerprint(const Problem& problem);

}  // namespace clba
