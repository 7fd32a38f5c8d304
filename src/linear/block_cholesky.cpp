// SPDX-License-Identifier: Apache-2.0
#include "linear/block_cholesky.hpp"

#include <algorithm>
#include <cstring>

#include "base/error.hpp"
#include "linear/arena.hpp"
#include "linear/elimination_order.hpp"
#include "linear/flush_subnormals.hpp"

namespace clba {
namespace {

std::vector<int64_t> block_begins(const BlockPattern& pattern) {
    std::vector<int64_t> begin = {0};
    for (const int32_t size : pattern.block_size) begin.push_back(begin.back() + size);
    return begin;
}

std::vector<int64_t> value_begins(const BlockPattern& pattern) {
    std::vector<int64_t> begin = {0};
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k)
            begin.push_back(begin.back() + int64_t{pattern.block_size[row]} *
                                               pattern.block_size[pattern.columns[k]]);
    return begin;
}

FrontTree ordered_fronts(const BlockPattern& pattern, int num_threads) {
    require(num_threads >= 1, "num_threads = ", num_threads, ", but it must be >= 1");
    check_pattern(pattern);
    const BlockGraph graph = make_graph(pattern);
    return make_fronts(graph, elimination_order(graph, num_threads));
}

// A block of rows x columns, stored by rows, or its transpose into a matrix stored by columns.
template <class Real>
void place_block(const Real* block, int32_t rows, int32_t columns, bool transposed, Real* entry,
                 int64_t stride) {
    if (transposed) {
        for (int32_t i = 0; i < rows; ++i, block += columns, entry += stride)
            std::memcpy(entry, block, columns * sizeof(Real));
        return;
    }
    for (int32_t j = 0; j < columns; ++j, entry += stride)
        for (int32_t i = 0; i < rows; ++i) entry[i] = block[i * columns + j];
}

// Loops over less data are not shared between threads.
constexpr int64_t min_shared_values = 100000;

}  // namespace

double estimate_flops(const BlockPattern& pattern) {
    check_pattern(pattern);
    const BlockGraph graph = make_graph(pattern);
    double flops = 0;
    for (const double of_block : make_tree(graph, elimination_order(graph, 1)).flops)
        flops += of_block;
    return flops;
}

double estimate_factor_values(const BlockPattern& pattern) {
    check_pattern(pattern);
    const BlockGraph graph = make_graph(pattern);
    const std::vector<int32_t> order = elimination_order(graph, 1);
    const EliminationTree tree = make_tree(graph, order);
    double num_values = 0;
    for (size_t i = 0; i < order.size(); ++i) {
        const double pivots = graph.weight[order[i]];
        num_values += pivots * (0.5 * (pivots + 1) + static_cast<double>(tree.rows_below[i]));
    }
    return num_values;
}

template <class Real>
BlockCholesky<Real>::BlockCholesky(const BlockPattern& pattern, int num_threads, int order_threads,
                                   InstructionSet set)
    : kernels_(dense_kernels<Real>(set)),
      tree_(ordered_fronts(pattern, order_threads > 0 ? order_threads : num_threads)),
      value_begin_(value_begins(pattern)),
      pattern_begin_(block_begins(pattern)),
      pool_(num_threads) {
    split_fronts();
    place_fronts(pattern);
    place_updates();
    workspaces_.allocate(num_threads * kernel_workspace_size);
}

template <class Real>
void BlockCholesky<Real>::split_fronts() {
    const auto num_fronts = static_cast<int32_t>(tree_.fronts.size());
    std::vector<int32_t> parent, first(num_fronts);
    std::vector<double> flops;
    for (int32_t f = 0; f < num_fronts; ++f) {
        const Front& front = tree_.fronts[f];
        first[f] = front.children.empty() ? f : first[front.children.front()];
        parent.push_back(front.parent);
        flops.push_back(front.flops());
        factor_flops_ += front.flops();
    }
    std::vector<char> in_subtree(num_fronts, 0);
    for (const int32_t root : split_tree(parent, flops, pool_.num_threads()).subtree_roots) {
        subtrees_.push_back({first[root], root + 1});
        std::fill(in_subtree.begin() + first[root], in_subtree.begin() + root + 1, char{1});
    }
    for (int32_t f = 0; f < num_fronts; ++f)
        if (!in_subtree[f]) shared_fronts_.push_back(f);
}

template <class Real>
void BlockCholesky<Real>::place_fronts(const BlockPattern& pattern) {
    int64_t panel_size = 0, vector_size = 0;
    for (const Front& front : tree_.fronts) {
        Storage storage = {};
        storage.panel = panel_size;
        storage.panel_stride = padded<Real>(front.num_rows());
        storage.update_stride = padded<Real>(front.num_below);
        storage.vector = vector_size;
        panel_size += storage.panel_stride * front.num_pivots;
        vector_size += padded<Real>(front.num_rows());
        num_factor_values_ +=
            front.num_pivots * (front.num_pivots + 1) / 2 + front.num_pivots * front.num_below;
        storage_.push_back(storage);
    }
    panels_.allocate(panel_size);
    vectors_.allocate(vector_size);
    place_sources(pattern);
}

template <class Real>
void BlockCholesky<Real>::place_sources(const BlockPattern& pattern) {
    const std::vector<int32_t> position = inverse_permutation(tree_.order);
    std::vector<int32_t> front_of(tree_.order.size());
    std::vector<std::vector<int64_t>> begin_below;
    for (size_t f = 0; f < tree_.fronts.size(); ++f) {
        const Front& front = tree_.fronts[f];
        std::fill(front_of.begin() + front.first_block, front_of.begin() + front.end_block,
                  static_cast<int32_t>(f));
        begin_below.push_back(rows_of_blocks_below(tree_, front));
    }
    std::vector<std::vector<Source>> by_front(tree_.fronts.size());
    for (int32_t row = 0; row < pattern.num_blocks(); ++row) {
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k) {
            const int32_t column = pattern.columns[k];
            const int32_t first = std::min(position[row], position[column]);
            const int32_t second = std::max(position[row], position[column]);
            const int32_t f = front_of[first];
            const Front& front = tree_.fronts[f];
            const int64_t target =
                row_in_front(tree_, front, begin_below[f], second) +
                row_in_front(tree_, front, begin_below[f], first) * storage_[f].panel_stride;
            by_front[f].push_back({value_begin_[k], storage_[f].panel + target,
                                   pattern.block_size[row], pattern.block_size[column],
                                   position[row] < position[column]});
        }
    }
    for (size_t f = 0; f < by_front.size(); ++f) {
        storage_[f].source_begin = static_cast<int64_t>(sources_.size());
        sources_.insert(sources_.end(), by_front[f].begin(), by_front[f].end());
        storage_[f].source_end = static_cast<int64_t>(sources_.size());
    }
}

// The update matrices of fronts [begin, end), which one thread factorises in this order; a matrix
// lives until its parent is assembled. Returns where their memory ends.
template <class Real>
int64_t BlockCholesky<Real>::place_updates(int32_t begin, int32_t end, int64_t base) {
    Arena arena;
    for (int32_t f = begin; f < end; ++f) {
        const Front& front = tree_.fronts[f];
        storage_[f].update = base + arena.allocate(storage_[f].update_stride * front.num_below);
        for (const int32_t child : front.children)
            if (tree_.fronts[child].num_below > 0) arena.release(storage_[child].update - base);
    }
    return base + arena.size();
}

template <class Real>
void BlockCholesky<Real>::place_updates() {
    int64_t size = 0;
    for (const Subtree& subtree : subtrees_) size = place_updates(subtree.begin, subtree.end, size);
    Arena arena;
    const auto is_shared = [&](int32_t f) {
        return std::binary_search(shared_fronts_.begin(), shared_fronts_.end(), f);
    };
    for (const int32_t f : shared_fronts_) {
        const Front& front = tree_.fronts[f];
        storage_[f].update = size + arena.allocate(storage_[f].update_stride * front.num_below);
        for (const int32_t child : front.children)
            if (is_shared(child) && tree_.fronts[child].num_below > 0)
                arena.release(storage_[child].update - size);
    }
    updates_.allocate(size + arena.size());
}

template <class Real>
FrontTarget<Real> BlockCholesky<Real>::target(int32_t front) {
    const Storage& storage = storage_[front];
    return {panels_.data() + storage.panel, storage.panel_stride, tree_.fronts[front].num_pivots,
            updates_.data() + storage.update, storage.update_stride};
}

template <class Real>
DenseThreads<Real> BlockCholesky<Real>::threads(bool shared, int worker) {
    return {&kernels_, shared ? &pool_ : nullptr, workspaces_.data(), worker};
}

template <class Real>
template <class Task>
void BlockCholesky<Real>::for_each_subtree(const Task& task) {
    pool_.run(static_cast<int64_t>(subtrees_.size()), [&](int64_t index, int worker) {
        const DenseThreads<Real> alone = threads(false, worker);
        task(subtrees_[index].begin, subtrees_[index].end, alone);
    });
}

// The front's entries of the matrix plus the update matrices of its children.
template <class Real>
void BlockCholesky<Real>::assemble(int32_t f, const Real* values,
                                   const DenseThreads<Real>& threads) {
    constexpr int64_t columns_per_task = 64, sources_per_task = 1024;
    const Front& front = tree_.fronts[f];
    const Storage& storage = storage_[f];
    const FrontTarget<Real> to = target(f);
    const int64_t num_rows = front.num_rows();

    threads.run((num_rows + columns_per_task - 1) / columns_per_task,
                num_rows * num_rows >= min_shared_values, [&](int64_t index, int) {
                    const int64_t begin = index * columns_per_task;
                    for (int64_t j = begin; j < std::min(begin + columns_per_task, num_rows); ++j) {
                        const bool pivot = j < to.num_pivots;
                        const int64_t k = pivot ? j : j - to.num_pivots;
                        Real* diagonal = pivot ? to.panel + k + k * to.panel_stride
                                               : to.update + k + k * to.update_stride;
                        std::fill_n(diagonal, num_rows - j, Real(0));
                    }
                });

    const int64_t num_sources = storage.source_end - storage.source_begin;
    threads.run((num_sources + sources_per_task - 1) / sources_per_task,
                num_sources >= 2 * sources_per_task, [&](int64_t index, int) {
                    const int64_t begin = storage.source_begin + index * sources_per_task;
                    const int64_t end = std::min(begin + sources_per_task, storage.source_end);
                    for (int64_t s = begin; s < end; ++s) {
                        const Source& source = sources_[s];
                        place_block(values + source.value, source.rows, source.columns,
                                    source.transposed, panels_.data() + source.target,
                                    to.panel_stride);
                    }
                });

    for (const int32_t child : front.children) {
        const Front& from = tree_.fronts[child];
        const FrontTarget<Real> update = target(child);
        threads.run((from.num_below + columns_per_task - 1) / columns_per_task,
                    from.num_below * from.num_below >= min_shared_values, [&](int64_t index, int) {
                        kernels_.extend_add(from.runs.data(),
                                            static_cast<int64_t>(from.runs.size()), update.update,
                                            update.update_stride, index * columns_per_task,
                                            (index + 1) * columns_per_task, to);
                    });
    }
}

template <class Real>
bool BlockCholesky<Real>::factorize_front(int32_t f, const Real* values,
                                          const DenseThreads<Real>& threads) {
    assemble(f, values, threads);
    return partial_factor(target(f), tree_.fronts[f].num_rows(), threads);
}

template <class Real>
bool BlockCholesky<Real>::factorize(const Real* values, const StopTest& stop) {
    const FlushSubnormals flush;
    const auto goes_on = [&] { return stop.cause() == StopCause::none; };
    failed_ = false;
    for_each_subtree([&](int32_t begin, int32_t end, const DenseThreads<Real>& alone) {
        for (int32_t f = begin; f < end && !failed_; ++f)
            if (!goes_on() || !factorize_front(f, values, alone)) failed_ = true;
    });
    if (failed_) return false;
    for (const int32_t f : shared_fronts_)
        if (!goes_on() || !factorize_front(f, values, threads(true, 0))) return false;
    return true;
}

// vector = (pivots; rows below) of b, less what the children's eliminations subtract; rows below
// then hold what is subtracted from the parent's.
template <class Real>
void BlockCholesky<Real>::solve_front_forward(int32_t f, const Real* b,
                                              const DenseThreads<Real>& threads) {
    const Front& front = tree_.fronts[f];
    Real* y = vectors_.data() + storage_[f].vector;
    Real* next = y;
    for (int32_t i = front.first_block; i < front.end_block; ++i) {
        const int32_t block = tree_.order[i];
        next = std::copy(b + pattern_begin_[block], b + pattern_begin_[block + 1], next);
    }
    std::fill(next, y + front.num_rows(), Real(0));
    for (const int32_t child : front.children) {
        const Front& from = tree_.fronts[child];
        const Real* update = vectors_.data() + storage_[child].vector + from.num_pivots;
        for (const ScatterRun& run : from.runs)
            for (int32_t i = 0; i < run.length; ++i) y[run.to + i] += update[run.from + i];
    }
    solve_forward(panels_.data() + storage_[f].panel, storage_[f].panel_stride, front.num_rows(),
                  front.num_pivots, y, threads);
}

template <class Real>
void BlockCholesky<Real>::solve_front_backward(int32_t f, Real* x,
                                               const DenseThreads<Real>& threads) {
    const Front& front = tree_.fronts[f];
    Real* y = vectors_.data() + storage_[f].vector;
    if (front.parent >= 0) {
        const Real* solution = vectors_.data() + storage_[front.parent].vector;
        for (const ScatterRun& run : front.runs)
            std::copy_n(solution + run.to, run.length, y + front.num_pivots + run.from);
    }
    solve_backward(panels_.data() + storage_[f].panel, storage_[f].panel_stride, front.num_rows(),
                   front.num_pivots, y, threads);
    const Real* next = y;
    for (int32_t i = front.first_block; i < front.end_block; ++i) {
        const int32_t block = tree_.order[i];
        const int64_t size = pattern_begin_[block + 1] - pattern_begin_[block];
        std::copy_n(next, size, x + pattern_begin_[block]);
        next += size;
    }
}

template <class Real>
void BlockCholesky<Real>::solve(const Real* b, Real* x) {
    const FlushSubnormals flush;
    const DenseThreads<Real> together = threads(true, 0);
    for_each_subtree([&](int32_t begin, int32_t end, const DenseThreads<Real>& alone) {
        for (int32_t f = begin; f < end; ++f) solve_front_forward(f, b, alone);
    });
    for (const int32_t f : shared_fronts_) solve_front_forward(f, b, together);
    for (auto f = shared_fronts_.rbegin(); f != shared_fronts_.rend(); ++f)
        solve_front_backward(*f, x, together);
    for_each_subtree([&](int32_t begin, int32_t end, const DenseThreads<Real>& alone) {
        for (int32_t f = end - 1; f >= begin; --f) solve_front_backward(f, x, alone);
    });
}

template <class Real>
void BlockCholesky<Real>::get_pivots(Real* pivots) const {
    for (size_t f = 0; f < tree_.fronts.size(); ++f) {
        const Real* reciprocal = panels_.data() + storage_[f].panel;
        for (int32_t i = tree_.fronts[f].first_block; i < tree_.fronts[f].end_block; ++i) {
            const int32_t block = tree_.order[i];
            for (int64_t k = pattern_begin_[block]; k < pattern_begin_[block + 1]; ++k) {
                pivots[k] = 1 / (*reciprocal * *reciprocal);
                reciprocal += storage_[f].panel_stride + 1;
            }
        }
    }
}

template class BlockCholesky<float>;
template class BlockCholesky<double>;

}  // namespace clba
