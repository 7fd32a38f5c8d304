// SPDX-License-Identifier: Apache-2.0
#include "linear/elimination_order.hpp"

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>
#include <algorithm>
#include <numeric>

namespace clba {
namespace {

using Blocks = std::vector<int32_t>;

// Parts of less are not cut.
constexpr size_t min_part = 64;

// Blocks of a part and, behind them, those outside it that have neighbours in it.
Blocks with_halo(const BlockGraph& graph, const Blocks& part, std::vector<int32_t>& local) {
    Blocks blocks = part;
    for (size_t i = 0; i < blocks.size(); ++i) local[blocks[i]] = static_cast<int32_t>(i);
    for (size_t i = 0; i < part.size(); ++i) {
        for (int64_t k = graph.begin[part[i]]; k < graph.begin[part[i] + 1]; ++k) {
            const int32_t other = graph.neighbours[k];
            if (local[other] >= 0) continue;
            local[other] = static_cast<int32_t>(blocks.size());
            blocks.push_back(other);
        }
    }
    return blocks;
}

// Minimum degree on the part and its halo, which is eliminated later: it is taken as connected
// within and with as many more blocks as keep its degree above those in the part. Appends the part
// to order.
void append_minimum_degree(const BlockGraph& graph, const Blocks& part, Blocks& order) {
    std::vector<int32_t> local(graph.num_blocks(), -1);
    const Blocks blocks = with_halo(graph, part, local);
    const auto part_size = static_cast<int32_t>(part.size());
    std::vector<Eigen::Triplet<char, int32_t>> entries;
    int64_t max_degree = 0;
    for (int32_t i = 0; i < part_size; ++i) {
        entries.emplace_back(i, i, 1);
        const int64_t begin = graph.begin[blocks[i]], end = graph.begin[blocks[i] + 1];
        max_degree = std::max(max_degree, end - begin);
        for (int64_t k = begin; k < end; ++k) {
            const int32_t j = local[graph.neighbours[k]];
            entries.emplace_back(i, j, 1);
            if (j >= part_size) entries.emplace_back(j, i, 1);
        }
    }
    auto n = static_cast<int32_t>(blocks.size());
    if (n > part_size) n += static_cast<int32_t>(max_degree);
    for (int32_t i = part_size; i < n; ++i)
        for (int32_t j = part_size; j < n; ++j) entries.emplace_back(i, j, 1);
    Eigen::SparseMatrix<char, Eigen::ColMajor, int32_t> matrix(n, n);
    matrix.setFromTriplets(entries.begin(), entries.end(), [](char a, char) { return a; });
    Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int32_t> permutation;
    Eigen::AMDOrdering<int32_t>()(matrix, permutation);
    for (int32_t i = 0; i < n; ++i) {
        const int32_t chosen = permutation.indices()[i];
        if (chosen < part_size) order.push_back(blocks[chosen]);
    }
}

// Blocks of a part by breadth-first search from start; where its component ends, the next one
// follows. Level of each block of the part in level, whose other entries stay -1.
Blocks by_levels(const BlockGraph& graph, const Blocks& part, int32_t start,
                 const std::vector<char>& in_part, std::vector<int32_t>& level) {
    Blocks queue;
    for (const int32_t block : part) level[block] = -1;
    size_t next_unseen = 0, head = 0;
    int32_t seed = start, seed_level = 0;
    while (queue.size() < part.size()) {
        level[seed] = seed_level;
        queue.push_back(seed);
        for (; head < queue.size(); ++head) {
            const int32_t block = queue[head];
            for (int64_t k = graph.begin[block]; k < graph.begin[block + 1]; ++k) {
                const int32_t other = graph.neighbours[k];
                if (!in_part[other] || level[other] >= 0) continue;
                level[other] = level[block] + 1;
                queue.push_back(other);
            }
        }
        seed_level = level[queue.back()] + 1;
        while (next_unseen < part.size() && level[part[next_unseen]] >= 0) ++next_unseen;
        if (next_unseen < part.size()) seed = part[next_unseen];
    }
    return queue;
}

struct Cut {
    Blocks first, second, separator;
};

// Cuts a part at a level of a breadth-first search from a block far from all others, such that
// neither side has less than a third of the rows.
Cut cut_part(const BlockGraph& graph, const Blocks& part) {
    std::vector<char> in_part(graph.num_blocks(), 0);
    for (const int32_t block : part) in_part[block] = 1;
    std::vector<int32_t> level(graph.num_blocks(), -1);
    Blocks queue = by_levels(graph, part, part.front(), in_part, level);
    queue = by_levels(graph, part, queue.back(), in_part, level);
    queue = by_levels(graph, part, queue.back(), in_part, level);

    const int32_t num_levels = level[queue.back()] + 1;
    std::vector<char> reaches_on(graph.num_blocks(), 0);
    std::vector<int64_t> before(num_levels + 1, 0), separator(num_levels, 0);
    for (const int32_t block : queue) {
        for (int64_t k = graph.begin[block]; k < graph.begin[block + 1]; ++k) {
            const int32_t other = graph.neighbours[k];
            if (in_part[other] && level[other] > level[block]) reaches_on[block] = 1;
        }
        before[level[block] + 1] += graph.weight[block];
        if (reaches_on[block]) separator[level[block]] += graph.weight[block];
    }
    std::partial_sum(before.begin(), before.end(), before.begin());
    const int64_t total = before.back();
    int32_t best = -1;
    double best_cost = 0;
    for (int32_t l = 0; l + 1 < num_levels; ++l) {
        const int64_t first = before[l + 1] - separator[l], second = total - before[l + 1];
        if (std::min(first, second) * 3 < total) continue;
        const double cost =
            static_cast<double>(separator[l]) + 0.1 * static_cast<double>(std::abs(first - second));
        if (best < 0 || cost < best_cost) {
            best = l;
            best_cost = cost;
        }
    }
    Cut cut;
    if (best < 0) return cut;
    for (const int32_t block : queue) {
        if (level[block] > best)
            cut.second.push_back(block);
        else if (level[block] == best && reaches_on[block])
            cut.separator.push_back(block);
        else
            cut.first.push_back(block);
    }
    return cut;
}

void append_dissection(const BlockGraph& graph, const Blocks& part, int depth, Blocks& order) {
    Cut cut;
    if (depth > 0 && part.size() >= min_part) cut = cut_part(graph, part);
    if (cut.first.empty()) return append_minimum_degree(graph, part, order);
    append_dissection(graph, cut.first, depth - 1, order);
    append_dissection(graph, cut.second, depth - 1, order);
    order.insert(order.end(), cut.separator.begin(), cut.separator.end());
}

}  // namespace

std::vector<int32_t> elimination_order(const BlockGraph& graph, int num_threads) {
    Blocks natural(graph.num_blocks());
    std::iota(natural.begin(), natural.end(), 0);
    Blocks best = natural;
    double best_time = 0;
    const auto try_order = [&](Blocks order) {
        const EliminationTree tree = make_tree(graph, order);
        const double time = split_tree(tree.parent, tree.flops, num_threads).time;
        if (best_time > 0 && time >= best_time) return;
        best_time = time;
        best = std::move(order);
    };
    try_order(natural);
    const int64_t n = graph.num_blocks();
    if (graph.begin.back() == n * (n - 1)) return best;
    for (int depth = 0; depth == 0 || (1 << depth) < 4 * num_threads; ++depth) {
        if (depth > 0 && num_threads == 1) break;
        Blocks order;
        append_dissection(graph, natural, depth, order);
        try_order(std::move(order));
    }
    return best;
}

}  // namespace clba
