// SPDX-License-Identifier: Apache-2.0
#include "linear/pcg_solvers.hpp"

#include <cmath>

namespace clba {
namespace {

// make_vector: a vector of the system's parts.
template <class MakeVector>
Pcg make_pcg(const LinearSolverOptions& options, DeviceProblem& problem, MakeVector&& make_vector) {
    return Pcg({options.min_iterations, options.max_iterations, options.eta}, problem.queue(),
               problem.vectors(), make_vector(), make_vector(), make_vector(), make_vector());
}

}  // namespace

PcgHessian::PcgHessian(const LinearSolverOptions& options, NormalEquations& equations)
    : equations_(equations), pcg_(make_pcg(options, equations.problem(), [&] {
          return equations.problem().make_vector("PCG");
      })) {
    DeviceProblem& problem = equations.problem();
    gradient_ = problem.make_vector("the gradient");
    damping_ = problem.make_vector("the damping");
    b_ = problem.make_vector("PCG");
    step_ = problem.make_vector("the step");
}

LinearSolution PcgHessian::solve(double lambda) {
    LinearSolution solution;
    VectorOperations& vectors = equations_.problem().vectors();
    solution.num_indefinite_blocks =
        equations_.factor_points(lambda) + equations_.factor_images(lambda, equations_.u());
    if (solution.num_indefinite_blocks > 0) return solution;
    equations_.get_gradient(gradient_);
    equations_.get_damping(damping_);
    vectors.scale_and_add(-1.0, gradient_, 0.0, b_);
    const PcgResult result = pcg_.solve(*this, lambda, damping_, b_, step_);
    solution.is_usable = result.is_usable;
    solution.num_iterations = result.num_iterations;
    if (solution.is_usable) take_step(equations_, gradient_, step_, solution);
    return solution;
}

void PcgHessian::get_step(Vector& full) {
    full.copy_from(step_);
}

void PcgHessian::add_product(const Vector& p, Vector& q) {
    equations_.jacobian.multiply(p);
    equations_.jacobian.add_transposed(q);
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
    b_ = problem.make_reduced_vector("PCG");
    step_ = problem.make_reduced_vector("the step");
    if (preconditioner_ == Preconditioner::schur_jacobi)
        schur_blocks_ = Buffer(problem.queue(), problem.matrices_bytes(), "Schur blocks");
}

LinearSolution PcgSchur::solve(double lambda) {
    LinearSolution solution;
    DeviceProblem& problem = equations_.problem();
    Jacobian& jacobian = equations_.jacobian;
    VectorOperations& vectors = problem.vectors();
    solution.num_indefinite_blocks = equations_.factor_points(lambda);
    if (solution.num_indefinite_blocks > 0) return solution;
    if (preconditioner_ == Preconditioner::schur_jacobi) {
        jacobian.schur_blocks(equations_.point_factors(), schur_blocks_);
        solution.num_indefinite_blocks = equations_.factor_images(lambda, schur_blocks_);
    } else {
        solution.num_indefinite_blocks = equations_.factor_images(lambda, equations_.u());
    }
    if (solution.num_indefinite_blocks > 0) return solution;

    // b = -g_F + W V^-1 g_E.
    jacobian.eliminate(equations_.point_gradient, equations_.point_factors(), b_);
    vectors.scale_and_add(-1.0, equations_.gradient, -1.0, b_);
    const PcgResult result = pcg_.solve(*this, lambda, equations_.damping(), b_, step_);
    solution.is_usable = result.is_usable;
    solution.num_iterations = result.num_iterations;
    if (!solution.is_usable) return solution;

    problem.update(step_);
    const BackSubstitution points =
        jacobian.back_substitute(step_, equations_.point_gradient, equations_.point_factors());
    solution.model_decrease =
        -(vectors.dot(equations_.gradient, step_) + points.slope) - 0.5 * points.squared_norm;
    solution.step_norm = std::sqrt(vectors.dot(step_, step_) + points.squared_point_steps);
    return solution;
}

void PcgSchur::get_step(Vector& full) {
    full.f.copy_from(step_.f);
    for (size_t c = 0; c < full.e.size(); ++c)
        equations_.problem().vectors().from_real(equations_.jacobian.point_step()[c], full.e[c]);
}

void PcgSchur::add_product(const Vector& p, Vector& q) {
    equations_.jacobian.add_schur_product(p, equations_.point_factors(), q);
}

void PcgSchur::precondition(const Vector& r, Vector& z) {
    equations_.apply_image_factors(r, z);
}

}  // namespace clba
