// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <atomic>
#include <cstdint>
#include <vector>

#include "base/stop_test.hpp"
#include "linear/aligned_array.hpp"
#include "linear/block_pattern.hpp"
#include "linear/front_tree.hpp"
#include "linear/partial_factor.hpp"
#include "linear/worker_pool.hpp"

namespace clba {

template <class Real>
class BlockInverse;

// A = L L^T on the host for a sparse symmetric positive definite matrix of blocks, by fronts
// (multifrontal), for values that change and a pattern that does not. For one caller at a time.
// Results have the same bits for every number of threads that leads to the same order of
// elimination; the order is that of order_threads threads.
template <class Real>
class BlockCholesky {
public:
    // Order, symbolic analysis, threads and memory: nothing is allocated later. num_threads >= 1
    // counts the caller; order_threads 0 means num_threads. The instruction set must be available.
    BlockCholesky(const BlockPattern& pattern, int num_threads, int order_threads = 0,
                  InstructionSet set = available_instruction_sets().back());

    int64_t num_rows() const { return tree_.row_begin.back(); }
    // Blocks lie in values one after the other in the order of the pattern's entries, each by rows.
    int64_t num_values() const { return value_begin_.back(); }
    int64_t value_offset(int64_t entry) const { return value_begin_[entry]; }

    // False: not positive definite, or not finite, or `stop` ended it; another matrix may follow.
    // Only the lower triangle of the diagonal blocks is read.
    bool factorize(const Real* values, const StopTest& stop = {});
    // A x = b with the last factor, which must have been positive definite. x may be b.
    void solve(const Real* b, Real* x);
    // Of the last factor, by row of the matrix: what was left of each diagonal entry when it was
    // eliminated.
    void get_pivots(Real* pivots) const;

    int64_t num_factor_values() const { return num_factor_values_; }  // with zeros that are stored
    double factor_flops() const { return factor_flops_; }             // on those values

private:
    friend class BlockInverse<Real>;

    // A block of the matrix and where its first entry goes in the panel of its front.
    struct Source {
        int64_t value, target;
        int32_t rows, columns;
        bool transposed;  // its row is eliminated before its column
    };
    struct Storage {
        int64_t panel, panel_stride;    // L of the front: num_rows x num_pivots
        int64_t update, update_stride;  // num_below x num_below
        int64_t vector;                 // num_rows
        int64_t source_begin, source_end;
    };

    struct Subtree {
        int32_t begin, end;  // fronts
    };

    void place_fronts(const BlockPattern& pattern);
    void place_updates();
    int64_t place_updates(int32_t begin, int32_t end, int64_t base);
    void place_sources(const BlockPattern& pattern);
    void split_fronts();

    FrontTarget<Real> target(int32_t front);
    DenseThreads<Real> threads(bool shared, int worker);
    void assemble(int32_t front, const Real* values, const DenseThreads<Real>& threads);
    bool factorize_front(int32_t front, const Real* values, const DenseThreads<Real>& threads);
    void solve_front_forward(int32_t front, const Real* b, const DenseThreads<Real>& threads);
    void solve_front_backward(int32_t front, Real* x, const DenseThreads<Real>& threads);
    // task(first front, end, threads) for each subtree, in parallel.
    template <class Task>
    void for_each_subtree(const Task& task);

    const DenseKernels<Real>& kernels_;
    FrontTree tree_;
    std::vector<Storage> storage_;
    std::vector<Source> sources_;
    std::vector<int64_t> value_begin_;    // of each entry; one more
    std::vector<int64_t> pattern_begin_;  // of the rows of each block in b and x; one more
    // Subtrees for one thread each, the costliest first, and the fronts above them, ascending.
    std::vector<Subtree> subtrees_;
    std::vector<int32_t> shared_fronts_;
    int64_t num_factor_values_ = 0;
    double factor_flops_ = 0;

    AlignedArray<Real> panels_, updates_, vectors_, workspaces_;
    std::atomic<bool> failed_{false};
    WorkerPool pool_;
};

// Multiplications and additions of a factorisation, without its memory; for models of cost.
double estimate_flops(const BlockPattern& pattern);
// Numbers of its factor, likewise.
double estimate_factor_values(const BlockPattern& pattern);

}  // namespace clba
