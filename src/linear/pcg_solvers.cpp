// SPDX-License-Identifier: Apache-2.0
#include "linear/pcg_solvers.hpp"

namespace clba {
namespace {

PcgOptions pcg_options(const LinearSolverOptions& options) {
    return {options.min_iterations, options.max_iterations, options.eta};
}

}  // namespace

PcgHessian::PcgHessian(const LinearSolverOptions& options, NormalEquations& equations)
    : options_(pcg_options(options)), equations_(equations) {
    DeviceProblem& problem = equations.problem();
    work_ = {problem.make_vector("PCG"), problem.make_vector("PCG"), problem.make_vector("PCG"),
             problem.make_vector("PCG")};
    b_ = problem.make_vector("PCG");
}

LinearSolution PcgHessian::solve(double lambda, Vector& step) {
    LinearSolution solution;
    VectorOperations& vectors = equations_.problem().vectors();
    lambda_ = lambda;
    solution.num_indefinite_blocks =
        equations_.factor_points(lambda) + equations_.factor_images(lambda, equations_.u());
    if (solution.num_indefinite_blocks > 0) return solution;
    vectors.scale_and_add(-1.0, equations_.gradient, 0.0, b_);
    const PcgResult result = pcg(*this, options_, vectors, b_, work_, step);
    solution.is_usable = result.is_usable;
    solution.num_iterations = result.num_iterations;
    return solution;
}

void PcgHessian::multiply(const Vector& p, Vector& q) {
    equations_.jacobian.multiply(p);
    equations_.jacobian.multiply_transposed(q);
    equations_.problem().vectors().add_damping(lambda_, equations_.damping(), p, q);
}

void PcgHessian::precondition(const Vector& r, Vector& z) {
    equations_.apply_image_factors(r, z);
    equations_.apply_point_factors(r, z);
}

PcgSchur::PcgSchur(const LinearSolverOptions& options, NormalEquations& equations)
    : options_(pcg_options(options)),
      preconditioner_(options.preconditioner),
      equations_(equations) {
    DeviceProblem& problem = equations.problem();
    work_ = {problem.make_reduced_vector("PCG"), problem.make_reduced_vector("PCG"),
             problem.make_reduced_vector("PCG"), problem.make_reduced_vector("PCG")};
    b_ = problem.make_reduced_vector("PCG");
    points_ = problem.make_vector("elimination");
    if (preconditioner_ == Preconditioner::schur_jacobi)
        schur_blocks_ = Buffer(problem.queue(), problem.matrices_bytes(), "Schur blocks");
}

LinearSolution PcgSchur::solve(double lambda, Vector& step) {
    LinearSolution solution;
    StoredJacobian& jacobian = equations_.jacobian;
    VectorOperations& vectors = equations_.problem().vectors();
    lambda_ = lambda;
    solution.num_indefinite_blocks = equations_.factor_points(lambda);
    if (solution.num_indefinite_blocks > 0) return solution;
    if (preconditioner_ == Preconditioner::schur_jacobi) {
        jacobian.schur_blocks(equations_.point_factors(), schur_blocks_);
        solution.num_indefinite_blocks = equations_.factor_images(lambda, schur_blocks_);
    } else {
        solution.num_indefinite_blocks = equations_.factor_images(lambda, equations_.u());
    }
    if (solution.num_indefinite_blocks > 0) return solution;

    // b = -g_F + W z with z = V^-1 g_E, and W z the F side of J^T J [0; z].
    points_.f.fill_zero();
    equations_.apply_point_factors(equations_.gradient, points_);
    jacobian.multiply(points_);
    jacobian.multiply_transposed(points_);
    b_.f.copy_from(points_.f);
    vectors.scale_and_add(-1.0, equations_.gradient, 1.0, b_);
    const PcgResult result = pcg(*this, options_, vectors, b_, work_, step);
    solution.is_usable = result.is_usable;
    solution.num_iterations = result.num_iterations;
    if (!solution.is_usable) return solution;

    // delta_E = -V^-1 (g_E + W^T delta_F), and W^T delta_F the E side of J^T J [delta_F; 0].
    jacobian.multiply(step);
    jacobian.multiply_transposed(points_);
    vectors.scale_and_add(1.0, equations_.gradient, 1.0, points_);
    vectors.scale_and_add(-1.0, points_, 0.0, points_);
    equations_.apply_point_factors(points_, step);
    return solution;
}

void PcgSchur::multiply(const Vector& p, Vector& q) {
    equations_.jacobian.schur_multiply(p, equations_.point_factors(), q);
    equations_.problem().vectors().add_damping(lambda_, equations_.damping(), p, q);
}

void PcgSchur::precondition(const Vector& r, Vector& z) {
    equations_.apply_image_factors(r, z);
}

}  // namespace clba
