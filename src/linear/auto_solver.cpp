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

LinearSolution AutoSolver::solve(double lambda) {
    ++num_steps_;
    if (!explicit_ || lambda > explicit_lambda_) {
        last_ = &pcg_;
        const LinearSolution solution = pcg_.solve(lambda);
        if (solution.num_iterations <= few_iterations) return solution;
        if (!break_even_) {
            break_even_ = break_even_iterations();
            pcg_.limit_iterations(
                static_cast<int>(std::min<double>(max_iterations_, std::ceil(*break_even_))));
        }
        if (solution.num_iterations < *break_even_) return solution;
        if (!explicit_ && !make_explicit(solution.num_iterations)) return solution;
        explicit_lambda_ = lambda;
    }
    last_ = explicit_.get();
    return explicit_->solve(lambda);
}

bool AutoSolver::make_explicit(int num_iterations) {
    try {
        explicit_ = std::make_unique<ExplicitSchur>(problem_, equations_, std::move(*structure_));
    } catch (const Error& error) {
        if (error.status() != Status::out_of_memory) throw;
        reason_ = "there was no memory for explicit_schur";
        break_even_ = std::numeric_limits<double>::infinity();
        pcg_.limit_iterations(max_iterations_);
        return false;
    }
    reason_ = text("step ", num_steps_, " took ", num_iterations,
                   " or more iterations of conjugate gradients; an exact step costs as much as ",
                   std::llround(*break_even_), ", and is taken where lambda is as small");
    return true;
}

void AutoSolver::get_step(Vector& full) {
    last_->get_step(full);
}

LinearSolverKind AutoSolver::kind() const {
    return explicit_ ? explicit_->kind() : pcg_.kind();
}

}  // namespace clba
