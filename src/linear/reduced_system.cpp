// SPDX-License-Identifier: Apache-2.0
#include "linear/reduced_system.hpp"

#include <cmath>

#include "linear/prior_terms.hpp"

namespace clba {

void reduced_right_side(NormalEquations& equations, const Vector& zero, Vector& b) {
    equations.jacobian.eliminate(zero, equations.point_gradient, equations.point_factors(), b);
    equations.problem().vectors().scale_and_add(-1.0, equations.gradient, -1.0, b);
}

void take_reduced_step(NormalEquations& equations, const Vector& step, LinearSolution& solution) {
    DeviceProblem& problem = equations.problem();
    VectorOperations& vectors = problem.vectors();
    problem.update(step);
    const BackSubstitution points = equations.jacobian.back_substitute(
        step, equations.point_gradient, equations.point_factors());
    const double of_priors =
        problem.priors() ? problem.priors()->squared_norm(step, equations.jacobian.point_step())
                         : 0;
    solution.model_decrease = -(vectors.dot(equations.gradient, step) + points.slope) -
                              0.5 * (points.squared_norm + of_priors);
    solution.step_norm = std::sqrt(vectors.dot(step, step) + points.squared_point_steps);
}

void get_reduced_step(NormalEquations& equations, const Vector& step, Vector& full) {
    full.f.copy_from(step.f);
    for (size_t c = 0; c < full.e.size(); ++c)
        equations.problem().vectors().from_real(equations.jacobian.point_step()[c], full.e[c]);
}

}  // namespace clba
