// SPDX-License-Identifier: Apache-2.0
#include "linear/block_inverse.hpp"

#include <algorithm>
#include <cstring>

#include "linear/arena.hpp"
#include "linear/flush_subnormals.hpp"
#include "linear/partial_inverse.hpp"

namespace clba {

template <class Real>
BlockInverse<Real>::BlockInverse(BlockCholesky<Real>& factor)
    : factor_(factor),
      places_(factor.tree_.fronts.size()),
      is_shared_(factor.tree_.fronts.size(), 0) {
    for (const int32_t f : factor.shared_fronts_) is_shared_[f] = 1;
    place_shared();
    place_subtrees();
}

template <class Real>
int64_t BlockInverse<Real>::matrix_size(int32_t f) const {
    const int64_t num_rows = factor_.tree_.fronts[f].num_rows();
    return padded<Real>(num_rows) * num_rows;
}

template <class Real>
int64_t BlockInverse<Real>::boundary_stride(int32_t f) const {
    return padded<Real>(factor_.tree_.fronts[f].num_below);
}

// A front's matrix lives until the last child that needs it, the first in the order of fronts, has
// taken its part.
template <class Real>
void BlockInverse<Real>::place_shared() {
    const std::vector<Front>& fronts = factor_.tree_.fronts;
    Arena arena;
    int64_t scratch = 0;
    const auto first_shared_child = [&](const Front& front) {
        const auto child = std::find_if(front.children.begin(), front.children.end(),
                                        [&](int32_t c) { return is_shared_[c] != 0; });
        return child == front.children.end() ? -1 : *child;
    };
    const std::vector<int32_t>& shared = factor_.shared_fronts_;
    for (auto f = shared.rbegin(); f != shared.rend(); ++f) {
        const Front& front = fronts[*f];
        places_[*f].matrix = arena.allocate(matrix_size(*f));
        scratch =
            std::max(scratch, partial_inverse_scratch<Real>(front.num_rows(), front.num_pivots));
        if (front.parent >= 0 && first_shared_child(fronts[front.parent]) == *f)
            arena.release(places_[front.parent].matrix);
        for (const int32_t child : front.children)
            if (!is_shared_[child])
                places_[child].boundary =
                    arena.allocate(boundary_stride(child) * fronts[child].num_below);
        if (first_shared_child(front) < 0) arena.release(places_[*f].matrix);
    }
    shared_.allocate(arena.size());
    shared_scratch_.allocate(scratch);
    num_work_values_ += arena.size() + scratch;
}

template <class Real>
void BlockInverse<Real>::place_subtrees() {
    const std::vector<Front>& fronts = factor_.tree_.fronts;
    for (const auto& subtree : factor_.subtrees_) {
        Arena arena;
        for (int32_t f = subtree.end - 1; f >= subtree.begin; --f) {
            const Front& front = fronts[f];
            places_[f].matrix = arena.allocate(matrix_size(f));
            scratch_size_ = std::max(
                scratch_size_, partial_inverse_scratch<Real>(front.num_rows(), front.num_pivots));
            const bool is_root = f == subtree.end - 1;
            if (!is_root && fronts[front.parent].children.front() == f)
                arena.release(places_[front.parent].matrix);
            if (front.children.empty()) arena.release(places_[f].matrix);
        }
        matrices_size_ = std::max(matrices_size_, arena.size());
    }
    matrices_size_ = padded<Real>(matrices_size_);
    scratch_size_ = padded<Real>(scratch_size_);
    const int64_t num_threads = factor_.pool_.num_threads();
    matrices_.allocate(num_threads * matrices_size_);
    scratches_.allocate(num_threads * scratch_size_);
    num_work_values_ += num_threads * (matrices_size_ + scratch_size_);
}

template <class Real>
void BlockInverse<Real>::gather(int32_t f, const Real* parent, int64_t parent_stride, Real* to,
                                int64_t stride) const {
    const std::vector<ScatterRun>& runs = factor_.tree_.fronts[f].runs;
    for (const ScatterRun& columns : runs) {
        for (int32_t j = 0; j < columns.length; ++j) {
            const Real* from = parent + (columns.to + j) * parent_stride;
            Real* column = to + (columns.from + j) * stride;
            for (const ScatterRun& rows : runs)
                std::copy_n(from + rows.to, rows.length, column + rows.from);
        }
    }
}

// The front's matrix, whose part of the rows below is there already, and from it the blocks of its
// pivots.
template <class Real>
void BlockInverse<Real>::invert_front(int32_t f, Real* matrix, Real* scratch,
                                      const DenseThreads<Real>& threads, Real* values) const {
    const Front& front = factor_.tree_.fronts[f];
    const auto& storage = factor_.storage_[f];
    const int64_t stride = padded<Real>(front.num_rows());
    partial_inverse(factor_.panels_.data() + storage.panel, storage.panel_stride, front.num_rows(),
                    front.num_pivots, matrix, stride, scratch, threads);
    for (int64_t s = storage.source_begin; s < storage.source_end; ++s) {
        const auto& source = factor_.sources_[s];
        const int64_t at = source.target - storage.panel;
        const Real* from = matrix + at % storage.panel_stride + at / storage.panel_stride * stride;
        const int64_t down = source.transposed ? stride : 1,
                      across = source.transposed ? 1 : stride;
        Real* to = values + source.value;
        for (int32_t i = 0; i < source.rows; ++i)
            for (int32_t j = 0; j < source.columns; ++j) *to++ = from[i * down + j * across];
    }
}

template <class Real>
void BlockInverse<Real>::invert_subtree(int32_t begin, int32_t end, const DenseThreads<Real>& alone,
                                        Real* values) {
    Real* matrices = matrices_.data() + alone.worker * matrices_size_;
    Real* scratch = scratches_.data() + alone.worker * scratch_size_;
    for (int32_t f = end - 1; f >= begin; --f) {
        const Front& front = factor_.tree_.fronts[f];
        Real* matrix = matrices + places_[f].matrix;
        const int64_t stride = padded<Real>(front.num_rows());
        Real* below = matrix + front.num_pivots * (stride + 1);
        if (f < end - 1) {
            const int64_t of_parent = padded<Real>(factor_.tree_.fronts[front.parent].num_rows());
            gather(f, matrices + places_[front.parent].matrix, of_parent, below, stride);
        } else {
            for (int64_t j = 0; j < front.num_below; ++j)
                std::copy_n(shared_.data() + places_[f].boundary + j * boundary_stride(f),
                            front.num_below, below + j * stride);
        }
        invert_front(f, matrix, scratch, alone, values);
    }
}

template <class Real>
void BlockInverse<Real>::compute(Real* values) {
    const FlushSubnormals flush;
    const DenseThreads<Real> together = factor_.threads(true, 0);
    const std::vector<int32_t>& shared = factor_.shared_fronts_;
    for (auto f = shared.rbegin(); f != shared.rend(); ++f) {
        const Front& front = factor_.tree_.fronts[*f];
        Real* matrix = shared_.data() + places_[*f].matrix;
        const int64_t stride = padded<Real>(front.num_rows());
        if (front.parent >= 0)
            gather(*f, shared_.data() + places_[front.parent].matrix,
                   padded<Real>(factor_.tree_.fronts[front.parent].num_rows()),
                   matrix + front.num_pivots * (stride + 1), stride);
        invert_front(*f, matrix, shared_scratch_.data(), together, values);
        for (const int32_t child : front.children)
            if (!is_shared_[child])
                gather(child, matrix, stride, shared_.data() + places_[child].boundary,
                       boundary_stride(child));
    }
    factor_.pool_.run(
        static_cast<int64_t>(factor_.subtrees_.size()), [&](int64_t index, int worker) {
            const auto& subtree = factor_.subtrees_[index];
            invert_subtree(subtree.begin, subtree.end, factor_.threads(false, worker), values);
        });
}

template class BlockInverse<float>;
template class BlockInverse<double>;

}  // namespace clba
