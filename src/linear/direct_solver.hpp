// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <vector>

#include "linear/linear_solver.hpp"
#include "reference/direct_schur.hpp"

namespace clba {

// The direct solution on the host: the device's Jacobian and gradient, a sparse Cholesky
// factorisation of the reduced camera system by the plug-in clba_cholmod.
class DirectSolver : public LinearSolver {
public:
    DirectSolver(const Problem& problem, NormalEquations& equations);
    LinearSolution solve(double lambda, const StopTest& stop) override;
    void get_step(Vector& full) override { full.copy_from(device_step_); }
    LinearSolverKind kind() const override { return LinearSolverKind::direct_schur; }

private:
    NormalEquations& equations_;
    const Problem& problem_;
    reference::DirectSchur direct_;
    reference::Jacobian jacobian_;
    std::vector<double> gradient_, damping_, step_;
    Vector device_gradient_, device_step_;
};

// The Jacobian in the caller's order and the block rows of reference::Jacobian, whose image
// and point lists, column count and sizes are set already. Columns of constants are not zeroed.
void download_jacobian(const DeviceProblem& problem, Jacobian& device_jacobian,
                       reference::Jacobian& jacobian);
// Lists of a Jacobian for the problem's observations, with its blocks 0.
reference::Jacobian empty_jacobian(const Problem& problem, const ParameterLayout& layout);
// Sets the columns of constant parameters to 0, but for the poses of images that are composed.
void zero_constant_columns(const Problem& problem, const ParameterLayout& layout,
                           reference::Jacobian& jacobian);

}  // namespace clba
