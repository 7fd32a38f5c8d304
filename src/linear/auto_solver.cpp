// SPDX-License-Identifier: Apache-2.0
#include "linear/auto_solver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "linear/schur_structure.hpp"

namespace clba {
namespace {

// Seconds of a core or compute unit, measured on CPUs (docs/performance.md); only their ratios
// matter.
constexpr double seconds_per_slot = 5e-9;      // of a product with S, PCG's vectors included
constexpr double seconds_per_pair = 15e-9;     // forming S
constexpr double seconds_per_record = 25e-9;   // likewise, an observation
constexpr double seconds_per_flop = 1 / 20e9;  // factoring S

// Fewer iterations are never worth the set-up of an explicit solver.
constexpr int few_iterations = 30;
constexpr double bytes_per_pair = 8, bytes_per_record = 128;
constexpr double most_memory = 0.25;  // of the device's

}  // namespace

AutoSolver::AutoSolver(const LinearSolverOptions& options, const Problem& problem,
                       NormalEquations& equations)
    : problem_(problem),
      equations_(equations),
      pcg_(options, equations),
      max_iterations_(options.max_iterations) {
    reason_ = "no step took more iterations of conjugate gradients than an exact one costs";
}

double AutoSolver::break_even_iterations() {
    DeviceProblem& device = equations_.problem();
    const double units = device.queue().context().device().compute_units, workers = num_workers();
    const auto num_slots = static_cast<double>(device.tiles().num_slots);
    const double of_product = num_slots * seconds_per_slot / units;
    const int64_t num_pairs = count_pairs(problem_);
    const double forming =
        (static_cast<double>(num_pairs) * seconds_per_pair + num_slots * seconds_per_record) /
        units;
    // What explicit_schur would hold, without S and its factor.
    const SliceSize slice = ExplicitSchur::slice_size(device);
    const double bytes =
        static_cast<double>(num_pairs) * bytes_per_pair +
        std::min(num_slots, static_cast<double>(slice.num_records)) * bytes_per_record;
    const DeviceInfo& info = device.queue().context().device();
    if (bytes > most_memory * static_cast<double>(info.global_memory_bytes))
        return std::numeric_limits<double>::infinity();
    structure_.emplace(problem_, device.tiles(), slice);
    const double flops = estimate_flops(schur_pattern(problem_, device.layout(), *structure_));
    return (forming + flops * seconds_per_flop / workers) / of_product;
}

void AutoSolver::find_break_even() {
    break_even_ = break_even_iterations();
    pcg_.limit_iterations(
        static_cast<int>(std::min<double>(max_iterations_, std::ceil(*break_even_))));
}

LinearSolution AutoSolver::solve(double lambda, const StopTest& stop) {
    ++num_steps_;
    if (!explicit_ || lambda > explicit_lambda_) {
        last_ = &pcg_;
        const LinearSolution solution = pcg_.solve(lambda, stop);
        if (solution.stopped != StopCause::none || solution.num_iterations <= few_iterations)
            return solution;
        if (!break_even_) find_break_even();
        if (solution.num_iterations < *break_even_) return solution;
        if (!explicit_) {
            explicit_step_ = num_steps_;
            explicit_iterations_ = solution.num_iterations;
            if (!make_explicit()) return solution;
        }
        explicit_lambda_ = lambda;
    }
    last_ = explicit_.get();
    return explicit_->solve(lambda, stop);
}

bool AutoSolver::make_explicit() {
    try {
        explicit_ = std::make_unique<ExplicitSchur>(problem_, equations_, std::move(*structure_));
    } catch (const Error& error) {
        if (error.status() != Status::out_of_memory) throw;
        reason_ = "there was no memory for explicit_schur";
        break_even_ = std::numeric_limits<double>::infinity();
        pcg_.limit_iterations(max_iterations_);
        return false;
    }
    reason_ = text("step ", explicit_step_, " took ", explicit_iterations_,
                   " or more iterations of conjugate gradients; an exact step costs as much as ",
                   std::llround(*break_even_), ", and is taken where lambda is as small");
    return true;
}

LinearSolverState AutoSolver::state() const {
    LinearSolverState state;
    state.num_steps = num_steps_;
    if (break_even_) state.break_even = *break_even_;
    state.is_explicit = explicit_ != nullptr;
    state.explicit_lambda = explicit_lambda_;
    state.explicit_step = explicit_step_;
    state.explicit_iterations = explicit_iterations_;
    return state;
}

void AutoSolver::restore(const LinearSolverState& state) {
    num_steps_ = state.num_steps;
    explicit_lambda_ = state.explicit_lambda;
    explicit_step_ = state.explicit_step;
    explicit_iterations_ = state.explicit_iterations;
    if (state.break_even < 0) return;
    if (std::isfinite(state.break_even))
        find_break_even();
    else
        break_even_ = state.break_even;  // there was no memory
    if (state.is_explicit) make_explicit();
}

void AutoSolver::get_step(Vector& full) {
    last_->get_step(full);
}

LinearSolverKind AutoSolver::kind() const {
    return explicit_ ? explicit_->kind() : pcg_.kind();
}

}  // namespace clba
