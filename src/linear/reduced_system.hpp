// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "linear/linear_solver.hpp"
#include "linear/normal_equations.hpp"

namespace clba {

// The reduced camera system S delta_F = b with S = U_lambda - W V_lambda^-1 W^T, after
// factor_points.

// b = -g_F + W V_lambda^-1 g_E. zero: an F vector of zeros.
void reduced_right_side(NormalEquations& equations, const Vector& zero, Vector& b);

// Moves the trial state by step, and the points by -V_lambda^-1 (g_E + W^T step), and completes the
// solution.
void take_reduced_step(NormalEquations& equations, const Vector& step, LinearSolution& solution);

// F and E of the step that was taken last.
void get_reduced_step(NormalEquations& equations, const Vector& step, Vector& full);

}  // namespace clba
