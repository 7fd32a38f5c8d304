// SPDX-License-Identifier: Apache-2.0
#include "optimizer/solve.hpp"

#include <algorithm>

#include "base/atomic_file.hpp"
#include "base/error.hpp"
#include "base/stopwatch.hpp"
#include "problem/fingerprint.hpp"
#include "reference/bundle.hpp"
#include "reference/priors.hpp"

namespace clba {
namespace {

bool has_free_parameters(const Problem& problem, const ParameterLayout& layout) {
    if (std::any_of(layout.scale.begin(), layout.scale.end(), [](double c) { return c > 0; }))
        return true;
    for (int32_t p = 0; p < problem.num_points(); ++p)
        if (point_scale(problem, p)[0] > 0) return true;
    return false;
}

// The summary of a solve that ends before it begins.
void end_at_start(const Problem& problem, Termination termination, Reason reason,
                  const char* message, Summary& summary) {
    summary.termination = termination;
    summary.reason = reason;
    summary.message = message;
    const reference::Cost cost = reference::residual(problem, nullptr);
    summary.initial_prior_cost = summary.final_prior_cost = reference::prior_cost(problem);
    summary.initial_cost = summary.final_cost = summary.reference_final_cost =
        cost.cost + summary.initial_prior_cost;
    summary.num_behind_initial = summary.num_behind_final = cost.num_behind;
    summary.num_singular = cost.num_singular;
    IterationRow row;
    row.step_is_accepted = row.step_is_valid = true;
    row.cost = summary.final_cost;
    row.num_behind = cost.num_behind;
    summary.rows.push_back(row);
}

// Of a solve that writes or reads checkpoints; looks whether they can be written, and reads what it
// resumes.
CheckpointKey open_checkpoints(const Problem& problem, const MinimizerOptions& options,
                               Precision precision, std::optional<Checkpoint>& resumed) {
    CheckpointKey key;
    if (options.checkpoint_path.empty() && options.resume_path.empty()) return key;
    key = {fingerprint(problem),
           options.linear_solver.kind,
           options.linear_solver.preconditioner,
           options.damping.policy,
           precision,
           options.jacobian};
    if (!options.checkpoint_path.empty()) AtomicFile probe(options.checkpoint_path);
    if (!options.resume_path.empty()) resumed = read_checkpoint(options.resume_path, key);
    return key;
}

}  // namespace

DeviceProblem& mirror(const Problem& problem, const std::shared_ptr<Context>& context,
                      Precision precision, std::unique_ptr<DeviceProblem>& device) {
    if (!device || &device->queue().context() != context.get() ||
        device->precision() != precision) {
        device.reset();
        device = std::make_unique<DeviceProblem>(context, problem, precision);
    }
    device->refresh(problem);
    device->upload_state(problem);
    return *device;
}

Summary solve(Problem& problem, const std::shared_ptr<Context>& context,
              const MinimizerOptions& options, Precision precision,
              std::unique_ptr<DeviceProblem>& device) {
    const Stopwatch watch;
    Summary summary;
    summary.linear_solver = options.linear_solver.kind;
    summary.preconditioner = options.linear_solver.preconditioner;
    if (options.linear_solver.kind != LinearSolverKind::direct_schur)
        summary.eta = options.linear_solver.eta;
    summary.damping = options.damping.policy;
    summary.jacobian = options.jacobian;
    summary.precision = precision;
    summary.device = context->device().name;
    std::optional<Checkpoint> resumed;
    const CheckpointKey key = open_checkpoints(problem, options, precision, resumed);
    const ParameterLayout layout(problem);
    summary.gauge = reference::gauge_of(problem, layout);
    if (problem.observations.empty() || !has_free_parameters(problem, layout)) {
        end_at_start(problem, Termination::convergence, Reason::nothing_to_do,
                     problem.observations.empty() ? "There are no observations."
                                                  : "Every parameter is constant.",
                     summary);
        summary.total_seconds = watch.seconds();
        return summary;
    }
    if (options.cancelled && *options.cancelled) {
        end_at_start(problem, Termination::user_stop, Reason::cancelled, "Cancelled by the caller.",
                     summary);
        summary.total_seconds = watch.seconds();
        return summary;
    }
    DeviceProblem& mirrored = mirror(problem, context, precision, device);
    mirrored.queue().reset_step_seconds();
    mirrored.queue().memory().reset_peak();
    summary.setup_seconds = watch.seconds();
    minimize(options, problem, mirrored, key, resumed, watch.seconds(), summary);
    Stopwatch finish;
    mirrored.download_state(problem);
    summary.setup_seconds += finish.lap();
    summary.reference_final_cost =
        reference::residual(problem, nullptr).cost + reference::prior_cost(problem);
    summary.reference_seconds = finish.lap();
    summary.peak_device_bytes = mirrored.queue().memory().peak_bytes;
    summary.total_seconds = watch.seconds();
    return summary;
}

}  // namespace clba
