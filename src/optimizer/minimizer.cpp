// SPDX-License-Identifier: Apache-2.0
#include "optimizer/minimizer.hpp"

#include <cmath>
#include <limits>

#include "base/error.hpp"
#include "base/stopwatch.hpp"
#include "optimizer/evaluator.hpp"
#include "optimizer/progress.hpp"
#include "optimizer/trust_region.hpp"

namespace clba {
namespace {

// Relative rounding of the cost in single precision: pixels have that of a float, and the rounding
// of thousands of them cancels in the sum of their squares but for a share like this.
constexpr double cost_rounding = 32.0 * std::numeric_limits<float>::epsilon();

// The loop, one object a solve. Each test that may end it says why in the summary.
class Minimizer {
public:
    Minimizer(const MinimizerOptions& options, const Problem& host, DeviceProblem& device,
              const CheckpointKey& key, double start_seconds, Summary& summary)
        : options_(options),
          key_(key),
          stop_(options.cancelled, options.max_seconds - start_seconds),
          device_(device),
          vectors_(device.vectors()),
          start_seconds_(start_seconds),
          summary_(summary),
          evaluator_(device, host),
          equations_(device, options.damping, options.jacobian, host.loss),
          solver_(make_linear_solver(options.linear_solver, host, equations_)),
          trust_region_(options.initial_radius, options.max_radius) {
        summary_.setup_seconds += lap();
    }

    void run(const std::optional<Checkpoint>& resumed) {
        if (resumed)
            resume(*resumed);
        else if (!start())
            return;
        while (!is_finished()) {
            row_ = IterationRow();
            row_.iteration = static_cast<int>(summary_.rows.size());
            const StopCause cause = take_step();
            if (cause != StopCause::none) {
                end_by(cause);
                return;
            }
            if (finish_iteration()) return;
            if (options_.checkpoint_every > 0 && row_.iteration % options_.checkpoint_every == 0)
                save_checkpoint();
        }
        save_checkpoint();
    }

    void finish() {
        summary_.final_cost = current_.cost;
        summary_.final_prior_cost = current_.prior_cost;
        summary_.num_behind_final = current_.num_behind;
        summary_.num_singular = current_.num_singular;
        summary_.step_seconds = device_.queue().step_seconds();
        summary_.linear_solver = solver_->kind();
        summary_.choice = solver_->reason();
    }

private:
    void end(Termination termination, Reason reason, const std::string& message) {
        summary_.termination = termination;
        summary_.reason = reason;
        summary_.message = message;
    }

    // Cost and derivatives of the initial state.
    bool start() {
        const CostEvaluation initial = evaluator_.cost(device_.state, nullptr);
        summary_.evaluate_seconds += lap();
        current_ = initial;
        summary_.initial_cost = initial.cost;
        summary_.initial_prior_cost = initial.prior_cost;
        summary_.num_behind_initial = initial.num_behind;
        row_.step_is_accepted = row_.step_is_valid = true;
        if (!std::isfinite(initial.cost)) {
            end(Termination::failure, Reason::invalid_start,
                "The cost at the initial point is not finite.");
            log_row();
            return false;
        }
        linearize();
        if (!std::isfinite(gradient_max_norm_)) {
            end(Termination::failure, Reason::invalid_start,
                "The gradient at the initial point is not finite.");
            log_row();
            return false;
        }
        state_norm_ = state_norm();
        return !finish_iteration();
    }

    void resume(const Checkpoint& from) {
        if (from.state.size() != device_.num_state_values())
            fail(Status::format, options_.resume_path, ": the checkpoint has ", from.state.size(),
                 " values of the state, but the problem has ", device_.num_state_values());
        device_.set_state_values(from.state);
        summary_.rows = from.rows;
        summary_.num_accepted_steps = from.num_accepted_steps;
        summary_.num_rejected_steps = from.num_rejected_steps;
        summary_.num_invalid_steps = from.num_invalid_steps;
        summary_.num_linear_solver_iterations = from.num_linear_solver_iterations;
        summary_.num_behind_initial = from.num_behind_initial;
        summary_.num_indefinite_blocks = from.num_indefinite_blocks;
        summary_.initial_cost = from.initial_cost;
        summary_.resumed_iteration = from.rows.back().iteration;
        trust_region_ = TrustRegion(from.radius, options_.max_radius, from.shrink_factor);
        consecutive_invalid_steps_ = from.consecutive_invalid_steps;
        model_decrease_ = from.model_decrease;
        current_ = evaluator_.cost(device_.state, nullptr);
        summary_.evaluate_seconds += lap();
        linearize();
        if (!from.fixed_damping.empty()) equations_.set_fixed_damping(from.fixed_damping);
        state_norm_ = state_norm();
        solver_->restore(from.linear_solver);
        seconds_before_ = from.rows.back().seconds;
        summary_.setup_seconds += lap();
    }

    // A solve must not be lost to a full disk: it goes on, and the summary tells.
    void save_checkpoint() {
        if (options_.checkpoint_path.empty()) return;
        Checkpoint checkpoint;
        checkpoint.key = key_;
        checkpoint.radius = trust_region_.radius();
        checkpoint.shrink_factor = trust_region_.shrink_factor();
        checkpoint.linear_solver = solver_->state();
        checkpoint.consecutive_invalid_steps = consecutive_invalid_steps_;
        checkpoint.model_decrease = model_decrease_;
        checkpoint.rows = summary_.rows;
        checkpoint.num_accepted_steps = summary_.num_accepted_steps;
        checkpoint.num_rejected_steps = summary_.num_rejected_steps;
        checkpoint.num_invalid_steps = summary_.num_invalid_steps;
        checkpoint.num_linear_solver_iterations = summary_.num_linear_solver_iterations;
        checkpoint.num_behind_initial = summary_.num_behind_initial;
        checkpoint.num_indefinite_blocks = summary_.num_indefinite_blocks;
        checkpoint.initial_cost = summary_.initial_cost;
        checkpoint.state = device_.state_values();
        checkpoint.fixed_damping = equations_.fixed_damping();
        try {
            write_checkpoint(checkpoint, options_.checkpoint_path);
            ++summary_.num_checkpoints;
        } catch (const Error& error) {
            summary_.checkpoint_error = error.what();
        }
        lap();
    }

    void linearize() {
        evaluator_.linearize(equations_);
        gradient_max_norm_ = equations_.gradient_max_norm();
        summary_.linearize_seconds += lap();
    }

    double state_norm() {
        double sum = vectors_.squared_norm(device_.state.poses) +
                     vectors_.squared_norm(device_.state.camera_params);
        for (const Buffer& points : device_.state.points) sum += vectors_.squared_norm(points);
        return std::sqrt(sum);
    }

    bool is_finished() {
        const auto iterations = static_cast<int>(summary_.rows.size()) - 1;
        if (iterations >= options_.max_iterations) {
            end(Termination::no_convergence, Reason::max_iterations,
                text("Maximum number of iterations reached: ", iterations, "."));
            return true;
        }
        const StopCause cause = stop_.cause();
        if (cause != StopCause::none) {
            end_by(cause);
            return true;
        }
        if (trust_region_.radius() < options_.min_radius) {
            end(Termination::convergence, Reason::min_radius,
                text("Trust region radius ", trust_region_.radius(), " < ", options_.min_radius,
                     "."));
            return true;
        }
        return false;
    }

    void end_by(StopCause cause) {
        if (cause == StopCause::cancelled)
            end(Termination::user_stop, Reason::cancelled, "Cancelled by the caller.");
        else
            end(Termination::no_convergence, Reason::max_seconds,
                text("Time budget used up: ", options_.max_seconds, " s."));
    }

    // Computes a step and takes it if the cost falls enough. Where the linear solver was stopped
    // that is the end, and why is returned: a step that time cut short is still taken, and logged,
    // but a checkpoint is of the state before it, from which the path goes on as if it had not
    // ended.
    StopCause take_step() {
        const LinearSolution solution = solver_->solve(trust_region_.lambda(), stop_);
        summary_.linear_solver_seconds += lap();
        if (solution.stopped == StopCause::none) {
            try_step(solution);
            return StopCause::none;
        }
        save_checkpoint();
        if (solution.stopped == StopCause::out_of_time && solution.is_usable) {
            try_step(solution);
            log_row();
            if (options_.on_iteration) options_.on_iteration(row_);
        }
        return solution.stopped;
    }

    void try_step(const LinearSolution& solution) {
        summary_.num_indefinite_blocks += solution.num_indefinite_blocks;
        summary_.num_linear_solver_iterations += solution.num_iterations;
        summary_.factorization_seconds += solution.factorization_seconds;
        row_.linear_solver_iterations = solution.num_iterations;
        row_.step_norm = solution.step_norm;
        // False for NaN too.
        if (!solution.is_usable || !(solution.model_decrease > 0) ||
            !std::isfinite(row_.step_norm)) {
            handle_invalid_step();
            return;
        }
        const CostEvaluation trial = evaluator_.cost(device_.trial, nullptr);
        summary_.evaluate_seconds += lap();
        if (!std::isfinite(trial.cost)) {
            handle_invalid_step();
            return;
        }
        consecutive_invalid_steps_ = 0;
        row_.step_is_valid = true;
        row_.cost_change = current_.cost - trial.cost;
        model_decrease_ = solution.model_decrease;
        row_.gain_ratio = row_.cost_change / solution.model_decrease;
        if (row_.cost_change > 0 && row_.gain_ratio > options_.min_relative_decrease) {
            row_.step_is_accepted = true;
            device_.state.swap(device_.trial);
            current_ = trial;
            ++summary_.num_accepted_steps;
            trust_region_.accept(row_.gain_ratio);
            linearize();
            state_norm_ = state_norm();
        } else {
            ++summary_.num_rejected_steps;
            trust_region_.reject();
        }
    }

    void handle_invalid_step() {
        ++summary_.num_invalid_steps;
        ++consecutive_invalid_steps_;
        // Damping below the rounding of the products damps nothing.
        trust_region_.limit(1 / real_epsilon(device_.precision()));
        trust_region_.reject();
    }

    void log_row() {
        row_.cost = current_.cost;
        row_.num_behind = current_.num_behind;
        row_.gradient_max_norm = gradient_max_norm_;
        row_.trust_region_radius = trust_region_.radius();
        row_.seconds = seconds_before_ + seconds();
        summary_.rows.push_back(row_);
        const Remaining remaining =
            estimate_remaining(summary_.rows, {options_.function_tolerance, options_.max_iterations,
                                               options_.max_seconds - seconds()});
        row_.remaining_iterations = remaining.iterations;
        row_.remaining_seconds = remaining.seconds;
        summary_.rows.back() = row_;
    }

    // Logs the row and looks at every reason to stop that it may give.
    bool finish_iteration() {
        log_row();
        const bool goes_on = !options_.on_iteration || options_.on_iteration(row_);
        if (has_converged()) return true;
        if (!goes_on) {
            end(Termination::user_stop, Reason::callback, "Stopped by the caller.");
            save_checkpoint();
            return true;
        }
        if (consecutive_invalid_steps_ > options_.max_consecutive_invalid_steps) {
            end(Termination::failure, Reason::invalid_steps,
                text(consecutive_invalid_steps_,
                     " steps in a row were invalid: the linear solver found none, or the cost was "
                     "not finite."));
            return true;
        }
        return false;
    }

    bool has_converged() {
        if (current_.cost <= options_.target_cost) {
            end(Termination::convergence, Reason::target_cost,
                text("Target cost reached: ", current_.cost, " <= ", options_.target_cost, "."));
            return true;
        }
        if (gradient_max_norm_ <= options_.gradient_tolerance) {
            end(Termination::convergence, Reason::gradient_tolerance,
                text("Gradient tolerance reached: |gradient| ", gradient_max_norm_,
                     " <= ", options_.gradient_tolerance, "."));
            return true;
        }
        if (row_.iteration == 0 || !row_.step_is_valid) return false;
        const double smallest_step =
            options_.parameter_tolerance * (state_norm_ + options_.parameter_tolerance);
        if (row_.step_norm <= smallest_step) {
            end(Termination::convergence, Reason::parameter_tolerance,
                text("Parameter tolerance reached: |step| ", row_.step_norm, " <= ", smallest_step,
                     "."));
            return true;
        }
        const double smallest_change = options_.function_tolerance * current_.cost;
        if (std::abs(row_.cost_change) <= smallest_change) {
            end(Termination::convergence, Reason::function_tolerance,
                text("Function tolerance reached: |cost change| ", std::abs(row_.cost_change),
                     " <= ", smallest_change, "."));
            return true;
        }
        const double rounding = cost_rounding * current_.cost;
        if (device_.precision() == Precision::single && !row_.step_is_accepted &&
            model_decrease_ <= rounding) {
            end(Termination::convergence, Reason::function_tolerance,
                text("Function tolerance reached: the decrease ", model_decrease_,
                     " that a rejected step promised is within the rounding of the cost, ",
                     rounding, "."));
            return true;
        }
        return false;
    }

    double seconds() const { return start_seconds_ + watch_.seconds(); }

    // Seconds since the last lap, less those that went into building kernels.
    double lap() {
        const double build_seconds = device_.queue().context().build_seconds();
        const double built = build_seconds - build_seconds_;
        build_seconds_ = build_seconds;
        summary_.build_seconds += built;
        return watch_.lap() - built;
    }

    const MinimizerOptions& options_;
    const CheckpointKey& key_;
    const StopTest stop_;
    DeviceProblem& device_;
    VectorOperations& vectors_;
    double start_seconds_;
    double seconds_before_ = 0;  // of the rows of a checkpoint
    Summary& summary_;
    Stopwatch watch_;
    double build_seconds_ = device_.queue().context().build_seconds();
    Evaluator evaluator_;
    NormalEquations equations_;
    std::unique_ptr<LinearSolver> solver_;
    TrustRegion trust_region_;
    CostEvaluation current_;
    double gradient_max_norm_ = 0;
    double model_decrease_ = 0;  // of the last valid step
    double state_norm_ = 0;
    int consecutive_invalid_steps_ = 0;
    IterationRow row_;
};

}  // namespace

void minimize(const MinimizerOptions& options, const Problem& host, DeviceProblem& device,
              const CheckpointKey& key, const std::optional<Checkpoint>& resumed,
              double start_seconds, Summary& summary) {
    Minimizer minimizer(options, host, device, key, start_seconds, summary);
    minimizer.run(resumed);
    minimizer.finish();
}

}  // namespace clba
