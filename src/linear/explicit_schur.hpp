// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <functional>
#include <memory>
#include <vector>

#include "linear/block_cholesky.hpp"
#include "linear/linear_solver.hpp"
#include "linear/schur_structure.hpp"

namespace clba {

// The reduced camera system formed on the device, block by block, and factored on the host by a
// block-sparse Cholesky factorisation: an exact step in WIDE.
class ExplicitSchur : public LinearSolver {
public:
    ExplicitSchur(const Problem& problem, NormalEquations& equations)
        : ExplicitSchur(problem, equations,
                        SchurStructure(problem, equations.problem().tiles(),
                                       slice_size(equations.problem()))) {}
    ExplicitSchur(const Problem& problem, NormalEquations& equations, SchurStructure structure);

    // Slices whose records fit the caches, with work for every compute unit.
    static SliceSize slice_size(DeviceProblem& problem);
    LinearSolution solve(double lambda, const StopTest& stop) override;
    void get_step(Vector& full) override;
    LinearSolverKind kind() const override { return LinearSolverKind::explicit_schur; }

    // Leaves the blocks of U - W V^-1 W^T on the device.
    void form_blocks();
    // use(values) with S + lambda D^2 as form_blocks left it, in the order of pattern()'s entries;
    // constants are left out. Values may be changed.
    void use_values(double lambda, const std::function<void(double*)>& use);
    // Puts rows and columns of the identity in place of those that are marked.
    void leave_out(const std::vector<char>& is_left_out, double* values) const;
    const BlockPattern& pattern() const { return pattern_; }
    BlockCholesky<double>& cholesky() { return cholesky_; }

private:
    // Part P of a block of pairs that goes to a block of S.
    struct Target {
        int64_t source, value;  // first numbers, in blocks_ and in values_
        int32_t source_stride, rows, columns;
        bool is_transposed;
        bool is_added_both_ways;  // P + P^T
        // Of rows and columns that are those of an image and are to be those of its frame (the part
        // is A^T P A of frame_tangent); -1: they stay.
        int32_t row_sensor, column_sensor;
    };

    void list_targets(const Problem& problem, const BlockPattern& pattern);
    template <class Wide>
    void add_targets(const Wide* blocks);
    void list_prior_targets();
    void finish_values(double lambda, double* values);

    NormalEquations& equations_;
    SchurStructure structure_;
    std::vector<int64_t> block_offset_;  // of the blocks of pairs
    BlockPattern pattern_;
    BlockCholesky<double> cholesky_;
    bool has_shared_cameras_;    // or rigs
    std::vector<Pose> sensors_;  // of rigs
    // Whether the blocks are factored where the device left them, else as values_.
    bool is_in_place() const {
        return !has_shared_cameras_ && equations_.problem().precision() != Precision::single;
    }
    std::vector<char> is_constant_;  // of each scalar; empty if none is
    std::vector<Target> targets_;    // only if there are shared cameras or rigs
    std::vector<double> values_;     // of S, likewise
    struct PriorTarget {
        int64_t value;   // of S
        int32_t source;  // of P (prior_terms.hpp)
    };
    std::vector<PriorTarget> prior_targets_;
    std::vector<double> damping_, right_side_;
    int32_t max_columns_ = 0;
    // On the device.
    struct SliceBuffers {
        int32_t num_blocks;
        Buffer blocks, block_pairs, pairs;
    };
    std::vector<SliceBuffers> slice_buffers_;
    Buffer block_rows_, block_columns_, block_offsets_;
    Buffer blocks_;
    Buffer records_;  // of observations, of one slice at a time
    Vector b_, step_;
};

}  // namespace clba
