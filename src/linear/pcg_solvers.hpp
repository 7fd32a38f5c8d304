// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "linear/linear_solver.hpp"
#include "linear/pcg.hpp"

namespace clba {

// PCG on H_lambda = J^T J + lambda D^2, never formed: w = J^T (J p) + lambda D^2 p, with the
// block-diagonal preconditioner blockdiag(U_lambda, V_lambda)^-1 (Tong et al. 2013, eq. 7 and 8).
class PcgHessian : public LinearSolver, private PcgSystem {
public:
    PcgHessian(const LinearSolverOptions& options, NormalEquations& equations);
    LinearSolution solve(double lambda, const StopTest& stop) override;
    void get_step(Vector& full) override;
    LinearSolverKind kind() const override { return LinearSolverKind::pcg_hessian; }

private:
    void add_product(const Vector& p, Vector& q) override;
    void precondition(const Vector& r, Vector& z) override;

    NormalEquations& equations_;
    Pcg pcg_;
    Vector gradient_, damping_, residual_, step_;
};

// PCG on the reduced camera system S = U_lambda - W V_lambda^-1 W^T, never formed, and
// back-substitution of the points.
class PcgSchur : public LinearSolver, private PcgSystem {
public:
    PcgSchur(const LinearSolverOptions& options, NormalEquations& equations);
    LinearSolution solve(double lambda, const StopTest& stop) override;
    // Of the solves to come.
    void limit_iterations(int max_iterations) { pcg_.limit_iterations(max_iterations); }
    void get_step(Vector& full) override;
    LinearSolverKind kind() const override { return LinearSolverKind::pcg_schur; }

    // How many blocks of the preconditioner are not positive definite: those count as constant. To
    // be called after factor_points.
    int64_t factor_preconditioner(double lambda);
    // S x = r for any r of the F side, which holds the residual afterwards.
    PcgResult solve_system(double lambda, Vector& r, Vector& x, const StopTest& stop = {});
    void add_product(const Vector& p, Vector& q) override;  // q += S p, undamped

private:
    void precondition(const Vector& r, Vector& z) override;

    Preconditioner preconditioner_;
    NormalEquations& equations_;
    Pcg pcg_;
    Vector residual_, step_;  // F alone
};

}  // namespace clba
