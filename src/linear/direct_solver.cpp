// SPDX-License-Identifier: Apache-2.0
#include "linear/direct_solver.hpp"

#include "base/stopwatch.hpp"
#include "linear/prior_terms.hpp"
#include "linear/rig_tangents.hpp"

namespace clba {
namespace {

template <class Real>
void download_blocks(const DeviceProblem& problem, Jacobian& device_jacobian,
                     reference::Jacobian& jacobian) {
    const int width = jacobian.columns;
    problem.visit_slots<Real>(device_jacobian.blocks(), Jacobian::num_block_rows,
                              [&](int64_t observation, int columns, auto&& slot) {
                                  double* image =
                                      jacobian.image_blocks.data() + observation * 2 * width;
                                  for (int k = 0; k < columns; ++k) {
                                      image[k] = slot(k);
                                      image[width + k] = slot(columns + k);
                                  }
                                  double* point = jacobian.point_blocks.data() + observation * 6;
                                  for (int k = 0; k < 6; ++k) point[k] = slot(2 * columns + k);
                              });
}

}  // namespace

reference::Jacobian empty_jacobian(const Problem& problem, const ParameterLayout& layout) {
    reference::Jacobian jacobian;
    jacobian.columns = layout.max_image_columns;
    for (const Observation& observation : problem.observations) {
        jacobian.image.push_back(observation.image);
        jacobian.point.push_back(observation.point);
    }
    const size_t rows = 2 * problem.observations.size();
    jacobian.image_blocks.assign(rows * static_cast<size_t>(jacobian.columns), 0.0);
    jacobian.point_blocks.assign(rows * 3, 0.0);
    return jacobian;
}

void download_jacobian(const DeviceProblem& problem, Jacobian& device_jacobian,
                       reference::Jacobian& jacobian) {
    if (problem.precision() == Precision::double_precision)
        download_blocks<double>(problem, device_jacobian, jacobian);
    else
        download_blocks<float>(problem, device_jacobian, jacobian);
}

void zero_constant_columns(const Problem& problem, const ParameterLayout& layout,
                           reference::Jacobian& jacobian) {
    const int width = jacobian.columns;
    for (int64_t i = 0; i < jacobian.num_observations(); ++i) {
        const int32_t image = jacobian.image[i];
        const int32_t camera = problem.images[image].camera;
        const auto point = point_scale(problem, jacobian.point[i]);
        const int num_columns = num_pose_params + problem.cameras[camera].num_params();
        for (int row = 0; row < 2; ++row) {
            double* image_row = jacobian.image_blocks.data() + (2 * i + row) * width;
            for (int k = 0; k < num_columns; ++k) {
                if (k < num_pose_params && layout.is_composed(image)) continue;
                const int32_t scalar = k < num_pose_params
                                           ? layout.pose_offset[image] + k
                                           : layout.intrinsics_offset[camera] + k - num_pose_params;
                if (!(layout.scale[scalar] > 0)) image_row[k] = 0;
            }
            double* point_row = jacobian.point_blocks.data() + (2 * i + row) * 3;
            for (int k = 0; k < 3; ++k)
                if (!(point[k] > 0)) point_row[k] = 0;
        }
    }
}

DirectSolver::DirectSolver(const Problem& problem, NormalEquations& equations)
    : equations_(equations),
      problem_(problem),
      direct_(problem, equations.problem().layout()),
      jacobian_(empty_jacobian(problem, equations.problem().layout())) {
    const auto n = static_cast<size_t>(equations.problem().layout().num_parameters(problem));
    gradient_.resize(n);
    damping_.resize(n);
    step_.resize(n);
    equations.keep_wide_gradient();
    device_gradient_ = equations.problem().make_vector("the gradient");
    device_step_ = equations.problem().make_vector("the step");
}

LinearSolution DirectSolver::solve(double lambda, const StopTest& stop) {
    DeviceProblem& device = equations_.problem();
    download_jacobian(device, equations_.jacobian, jacobian_);
    zero_constant_columns(problem_, device.layout(), jacobian_);
    if (const RigTangents* rigs = device.rigs())
        jacobian_.sensors = rigs->download_sensors(device.state, problem_.rigs.sensors);
    equations_.get_gradient(device_gradient_);
    device.download(device_gradient_, gradient_.data());
    equations_.get_damping(device_step_);
    device.download(device_step_, damping_.data());
    for (double& d : damping_) d *= lambda;
    LinearSolution solution;
    solution.num_iterations = 1;
    solution.stopped = stop.cause();
    if (solution.stopped != StopCause::none) return solution;
    const Stopwatch watch;
    const PriorTerms* priors = device.priors();
    solution.is_usable =
        direct_.solve(jacobian_, gradient_.data(), damping_.data(),
                      priors ? priors->values() : std::vector<double>(), step_.data());
    solution.factorization_seconds = watch.seconds();
    solution.num_indefinite_blocks = direct_.num_indefinite();
    if (!solution.is_usable) return solution;
    device.upload(step_.data(), device_step_);
    take_step(equations_, device_gradient_, device_step_, solution);
    return solution;
}

}  // namespace clba
