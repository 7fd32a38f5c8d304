// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"

namespace clba::reference {

// What holds the 7 freedoms of the similarities that change no residual of an observation. The
// numbers of clba.h.
enum class Gauge : int { free = 0, fixed_by_constants = 1, fixed_by_priors = 2 };

struct GaugeState {
    Gauge gauge = Gauge::free;
    int num_freedoms = 7;  // that neither constants nor priors hold
};

// At the problem's state: freedoms are counted as held where moving along them moves constants or
// the residuals of priors by more than 1e-5 of what moving along the others does.
GaugeState gauge_of(const Problem& problem, const ParameterLayout& layout);

}  // namespace clba::reference
