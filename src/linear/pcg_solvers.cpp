// SPDX-License-Identifier: Apache-2.0
#include "linear/pcg_solvers.hpp"

#include "linear/prior_terms.hpp"
#include "linear/reduced_system.hpp"

namespace clba {
namespace {

// make_vector: a vector of the system's parts.
template <class MakeVector>
Pcg make_pcg(const LinearSolverOptions& options, DeviceProblem& problem, MakeVector&& make_vector) {
    return Pcg({options.min_iterations, options.max_iterations, options.eta}, problem.queue(),
               problem.vectors(), make_vector(), make_vector());
}

}  // namespace

PcgHessian::PcgHessian(const LinearSolverOptions& options, NormalEquations& equations)
    : equations_(equations), pcg_(make_pcg(options, equations.problem(), [&] {
          return equations.problem().make_vector("PCG");
      })) {
    DeviceProblem& problem = equations.problem();
    equations.keep_wide_gradient();
    gradient_ = problem.make_vector("the gradient");
    damping_ = problem.make_vector("the damping");
    residual_ = problem.make_vector("PCG");
    step_ = problem.make_vector("the step");
}

LinearSolution PcgHessian::solve(double lambda, const StopTest& stop) {
    LinearSolution solution;
    VectorOperations& vectors = equations_.problem().vectors();
    solution.num_indefinite_blocks =
        equations_.factor_points(lambda) + equations_.factor_image_blocks(lambda);
    if (solution.num_indefinite_blocks > 0) return solution;
    equations_.get_gradient(gradient_);
    equations_.get_damping(damping_);
    vectors.scale_and_add(-1.0, gradient_, 0.0, residual_);
    const PcgResult result = pcg_.solve(*this, lambda, damping_, residual_, step_, stop);
    solution.is_usable = result.is_usable;
    solution.num_iterations = result.num_iterations;
    solution.stopped = result.stopped;
    if (solution.is_usable) take_step(equations_, gradient_, step_, solution);
    return solution;
}

void PcgHessian::get_step(Vector& full) {
    full.copy_from(step_);
}

void PcgHessian::add_product(const Vector& p, Vector& q) {
    equations_.jacobian.multiply(p);
    equations_.jacobian.add_transposed(q);
    if (PriorTerms* priors = equations_.problem().priors()) {
        priors->add_image_product(p.f, q.f);
        priors->add_point_product(p.e, q.e);
    }
}

void PcgHessian::precondition(const Vector& r, Vector& z) {
    equations_.apply_image_factors(r, z);
    equations_.apply_point_factors(r, z);
}

PcgSchur::PcgSchur(const LinearSolverOptions& options, NormalEquations& equations)
    : preconditioner_(options.preconditioner),
      equations_(equations),
      pcg_(make_pcg(options, equations.problem(),
                    [&] { return equations.problem().make_reduced_vector("PCG"); })) {
    DeviceProblem& problem = equations.problem();
    residual_ = problem.make_reduced_vector("PCG");
    step_ = problem.make_reduced_vector("the step");
}

LinearSolution PcgSchur::solve(double lambda, const StopTest& stop) {
    LinearSolution solution;
    solution.num_indefinite_blocks = equations_.factor_points(lambda);
    if (solution.num_indefinite_blocks > 0) return solution;
    solution.num_indefinite_blocks = factor_preconditioner(lambda);
    if (solution.num_indefinite_blocks > 0) return solution;

    step_.fill_zero();
    reduced_right_side(equations_, step_, residual_);
    const PcgResult result = solve_system(lambda, residual_, step_, stop);
    solution.is_usable = result.is_usable;
    solution.num_iterations = result.num_iterations;
    solution.stopped = result.stopped;
    if (solution.is_usable) take_reduced_step(equations_, step_, solution);
    return solution;
}

int64_t PcgSchur::factor_preconditioner(double lambda) {
    return preconditioner_ == Preconditioner::schur_jacobi ? equations_.factor_schur_blocks(lambda)
                                                           : equations_.factor_image_blocks(lambda);
}

PcgResult PcgSchur::solve_system(double lambda, Vector& r, Vector& x, const StopTest& stop) {
    return pcg_.solve(*this, lambda, equations_.damping(), r, x, stop);
}

void PcgSchur::get_step(Vector& full) {
    get_reduced_step(equations_, step_, full);
}

void PcgSchur::add_product(const Vector& p, Vector& q) {
    equations_.jacobian.add_schur_product(p, equations_.point_factors(), q);
    if (PriorTerms* priors = equations_.problem().priors()) priors->add_image_product(p.f, q.f);
}

void PcgSchur::precondition(const Vector& r, Vector& z) {
    equations_.apply_image_factors(r, z);
}

}  // namespace clba
