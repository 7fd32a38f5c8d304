// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "linear/aligned_array.hpp"
#include "linear/block_cholesky.hpp"

namespace clba {

// The blocks of A^-1 that lie in A's pattern, from A = L L^T, front by front from the roots down: a
// front needs of A^-1 what is at its own rows, all of which its parent has. The factor stays.
template <class Real>
class BlockInverse {
public:
    // Takes the memory. For the factor's caller alone.
    explicit BlockInverse(BlockCholesky<Real>& factor);
    int64_t num_work_values() const { return num_work_values_; }  // that it holds

    // values: like those of the matrix (BlockCholesky), diagonal blocks whole.
    void compute(Real* values);

private:
    struct Place {
        int64_t matrix;    // of the front, from the memory of its thread
        int64_t boundary;  // of a subtree's root: the part of A^-1 that the parent leaves for it
    };
    int64_t matrix_size(int32_t front) const;
    int64_t boundary_stride(int32_t front) const;
    void place_shared();
    void place_subtrees();
    // The rows below of `front` from its parent's matrix.
    void gather(int32_t front, const Real* parent, int64_t parent_stride, Real* to,
                int64_t stride) const;
    void invert_front(int32_t front, Real* matrix, Real* scratch, const DenseThreads<Real>& threads,
                      Real* values) const;
    void invert_subtree(int32_t begin, int32_t end, const DenseThreads<Real>& alone, Real* values);

    BlockCholesky<Real>& factor_;
    std::vector<Place> places_;
    std::vector<char> is_shared_;
    AlignedArray<Real> shared_, shared_scratch_;
    AlignedArray<Real> matrices_, scratches_;  // of each thread
    int64_t matrices_size_ = 0, scratch_size_ = 0;
    int64_t num_work_values_ = 0;
};

}  // namespace clba
