// SPDX-License-Identifier: Apache-2.0
#include "linear/elimination_tree.hpp"

#include <algorithm>
#include <queue>
#include <utility>

namespace clba {
namespace {

// Fronts of less are eliminated by one thread at nearly the speed of several.
constexpr double min_shared_flops = 5e6;
constexpr double shared_efficiency = 0.8;

}  // namespace

BlockGraph make_graph(const BlockPattern& pattern) {
    const int32_t num_blocks = pattern.num_blocks();
    BlockGraph graph;
    graph.weight = pattern.block_size;
    graph.begin.assign(num_blocks + 1, 0);
    for (int32_t row = 0; row < num_blocks; ++row) {
        for (int64_t k = pattern.row_begin[row]; k + 1 < pattern.row_begin[row + 1]; ++k) {
            ++graph.begin[row + 1];
            ++graph.begin[pattern.columns[k] + 1];
        }
    }
    for (int32_t block = 0; block < num_blocks; ++block)
        graph.begin[block + 1] += graph.begin[block];
    graph.neighbours.resize(graph.begin.back());
    std::vector<int64_t> next(graph.begin.begin(), graph.begin.end() - 1);
    for (int32_t row = 0; row < num_blocks; ++row) {
        for (int64_t k = pattern.row_begin[row]; k + 1 < pattern.row_begin[row + 1]; ++k) {
            graph.neighbours[next[row]++] = pattern.columns[k];
            graph.neighbours[next[pattern.columns[k]]++] = row;
        }
    }
    return graph;
}

double elimination_flops(double p, double u) {
    return p * (p * p / 3 + p * u + u * u);
}

std::vector<int32_t> inverse_permutation(const std::vector<int32_t>& order) {
    std::vector<int32_t> position(order.size());
    for (size_t i = 0; i < order.size(); ++i) position[order[i]] = static_cast<int32_t>(i);
    return position;
}

EliminationTree make_tree(const BlockGraph& graph, const std::vector<int32_t>& order) {
    const int32_t num_blocks = graph.num_blocks();
    const std::vector<int32_t> position = inverse_permutation(order);
    EliminationTree tree;
    tree.parent.assign(num_blocks, -1);
    tree.num_below.assign(num_blocks, 0);
    tree.rows_below.assign(num_blocks, 0);
    tree.flops.resize(num_blocks);

    // Row i of the factor has the columns on the paths up the tree from the entries of row i of the
    // matrix (Liu 1990); the paths grow the tree where they end before i.
    std::vector<int32_t> visited_by(num_blocks, -1);
    for (int32_t i = 0; i < num_blocks; ++i) {
        const int32_t block = order[i];
        visited_by[i] = i;
        for (int64_t k = graph.begin[block]; k < graph.begin[block + 1]; ++k) {
            for (int32_t j = position[graph.neighbours[k]]; j < i && visited_by[j] != i;) {
                visited_by[j] = i;
                ++tree.num_below[j];
                tree.rows_below[j] += graph.weight[block];
                if (tree.parent[j] < 0) tree.parent[j] = i;
                j = tree.parent[j];
            }
        }
    }
    for (int32_t i = 0; i < num_blocks; ++i)
        tree.flops[i] =
            elimination_flops(graph.weight[order[i]], static_cast<double>(tree.rows_below[i]));
    return tree;
}

std::vector<int32_t> postorder(const std::vector<int32_t>& parent) {
    const auto n = static_cast<int32_t>(parent.size());
    std::vector<int32_t> first_child(n, -1), next_sibling(n, -1), stack, order;
    order.reserve(n);
    // Backwards, so that siblings ascend.
    for (int32_t node = n - 1; node >= 0; --node) {
        if (parent[node] < 0) continue;
        next_sibling[node] = first_child[parent[node]];
        first_child[parent[node]] = node;
    }
    for (int32_t root = 0; root < n; ++root) {
        if (parent[root] >= 0) continue;
        stack.push_back(root);
        while (!stack.empty()) {
            const int32_t node = stack.back();
            const int32_t child = first_child[node];
            if (child < 0) {
                order.push_back(node);
                stack.pop_back();
            } else {
                first_child[node] = next_sibling[child];
                stack.push_back(child);
            }
        }
    }
    return order;
}

TreeSplit split_tree(const std::vector<int32_t>& parent, const std::vector<double>& flops,
                     int num_threads) {
    const auto n = static_cast<int32_t>(parent.size());
    std::vector<double> subtree = flops;
    std::vector<std::vector<int32_t>> children(n);
    using Candidate = std::pair<double, int32_t>;  // of a subtree: flops and root
    std::priority_queue<Candidate> open;
    double below = 0;  // flops in the subtrees
    for (int32_t node = 0; node < n; ++node) {
        below += flops[node];
        if (parent[node] >= 0) {
            subtree[parent[node]] += subtree[node];
            children[parent[node]].push_back(node);
        } else {
            open.push({subtree[node], node});
        }
    }
    double above = 0;  // time of what was opened
    int32_t num_opened = 0, best_opened = 0;
    double best_time = std::max(open.empty() ? 0 : open.top().first, below / num_threads);
    std::vector<int32_t> opened;
    while (num_threads > 1 && !open.empty() && above < best_time) {
        const int32_t node = open.top().second;
        open.pop();
        opened.push_back(node);
        for (const int32_t child : children[node]) open.push({subtree[child], child});
        below -= flops[node];
        above +=
            flops[node] / (flops[node] < min_shared_flops ? 1 : shared_efficiency * num_threads);
        ++num_opened;
        const double time =
            above + std::max(open.empty() ? 0 : open.top().first, below / num_threads);
        if (time < best_time) {
            best_time = time;
            best_opened = num_opened;
        }
    }
    std::vector<char> is_above(n, 0);
    for (int32_t i = 0; i < best_opened; ++i) is_above[opened[i]] = 1;
    TreeSplit split;
    split.time = best_time;
    for (int32_t node = 0; node < n; ++node)
        if (!is_above[node] && (parent[node] < 0 || is_above[parent[node]]))
            split.subtree_roots.push_back(node);
    std::stable_sort(split.subtree_roots.begin(), split.subtree_roots.end(),
                     [&](int32_t a, int32_t b) { return subtree[a] > subtree[b]; });
    return split;
}

}  // namespace clba
