// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

namespace clba {

// What the processor's vector units are used as; baseline is what the compiler was told to assume.
enum class InstructionSet { baseline, avx2, avx512 };
// Those that this build has and this processor runs, baseline first.
std::vector<InstructionSet> available_instruction_sets();

// A run of rows (and columns) of an update matrix and where it goes in the parent's front.
struct ScatterRun {
    int32_t from, to, length;
};

// A front while its children are added: its p pivot columns, and what is right of and below them.
template <class Real>
struct FrontTarget {
    Real* panel;
    int64_t panel_stride;
    int64_t num_pivots;
    Real* update;
    int64_t update_stride;
};

// Dense kernels for one thread. Matrices are stored by columns, the stride is from one column to
// the next. A factor's diagonal holds the reciprocals of the factor's diagonal entries. Each result
// is summed in an order that depends on the depth of the product alone, never on how a matrix is
// cut into the rows and columns of several calls. What is above a diagonal may be overwritten.
// workspace: kernel_workspace_size numbers, aligned to 64 bytes.
template <class Real>
struct DenseKernels {
    // C -= A B^T with C of m x n, A of m x k, B of n x k, where row i + diagonal >= column j.
    void (*subtract_product)(Real* c, int64_t c_stride, const Real* a, int64_t a_stride, int64_t m,
                             const Real* b, int64_t b_stride, int64_t n, int64_t k,
                             int64_t diagonal, Real* workspace);
    // A = L L^T in place, n x n. False: a pivot is not positive and finite.
    bool (*factor)(Real* a, int64_t a_stride, int64_t n, Real* workspace);
    // X := X L^-T with X of m x n.
    void (*solve_rows)(const Real* l, int64_t l_stride, int64_t n, Real* x, int64_t x_stride,
                       int64_t m, Real* workspace);
    // The lower triangle of a child's update matrix is added to the parent's front. Runs ascend,
    // and none holds both pivots and other rows.
    void (*extend_add)(const ScatterRun* runs, int64_t num_runs, const Real* child,
                       int64_t child_stride, int64_t begin, int64_t end,
                       const FrontTarget<Real>& front);
    // For L of m x n, m >= n, whose first n rows are lower triangular:
    // y[0, n) := L1^-1 y[0, n) and y[n, m) -= L2 y[0, n).
    void (*solve_forward)(const Real* l, int64_t l_stride, int64_t m, int64_t n, Real* y);
    // y[0, n) := L1^-T (y[0, n) - L2^T y[n, m)).
    void (*solve_backward)(const Real* l, int64_t l_stride, int64_t m, int64_t n, Real* y);
    // y -= A x and x -= A^T y with A of m x n.
    void (*subtract_times)(const Real* a, int64_t a_stride, int64_t m, int64_t n, const Real* x,
                           Real* y);
    void (*subtract_transposed_times)(const Real* a, int64_t a_stride, int64_t m, int64_t n,
                                      const Real* y, Real* x);
};

// Blocking of the products: a packed block of A stays in the second-level cache, a packed panel of
// B in the first.
constexpr int64_t kernel_depth = 256, kernel_rows = 192, kernel_columns = 384;
// The two packed blocks (the wider, rounded up to a micro-tile) and one micro-tile.
constexpr int64_t kernel_workspace_size =
    kernel_depth * (kernel_rows + kernel_columns + 64) + 48 * 16;

// float and double. The instruction set must be available.
template <class Real>
const DenseKernels<Real>& dense_kernels(InstructionSet set);

}  // namespace clba
