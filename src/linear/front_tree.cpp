// SPDX-License-Identifier: Apache-2.0
#include "linear/front_tree.hpp"

#include <algorithm>

namespace clba {
namespace {

// Seconds to assemble and eliminate a front of p pivots and u rows below, about; measured on one
// core with 512 bit vectors in double.
double front_seconds(double p, double u) {
    return 1e-6 + elimination_flops(p, u) / 55e9 + 0.5e-9 * p * (p + u) + 0.25e-9 * u * u;
}

// The same for pivots that may yet be joined with others into a front of the best size.
double share_of_front_seconds(double p, double u) {
    double seconds = front_seconds(p, u);
    for (double width = 8; width <= 128; width *= 2)
        if (width > p) seconds = std::min(seconds, front_seconds(width, u) * p / width);
    return seconds;
}

// Fronts before their structure: block columns that are eliminated together.
struct Groups {
    std::vector<int32_t> group_of;  // by position
    std::vector<int32_t> parent;    // by group; children are numbered below their parents
    std::vector<int64_t> pivots, below;
};

// Chains of columns of which each has the structure of the one before it less its own block.
Groups chains(const BlockGraph& graph, const std::vector<int32_t>& order,
              const EliminationTree& tree) {
    const auto n = static_cast<int32_t>(order.size());
    Groups groups;
    groups.group_of.resize(n);
    for (int32_t i = 0; i < n; ++i) {
        const bool joins =
            i > 0 && tree.parent[i - 1] == i && tree.num_below[i - 1] == tree.num_below[i] + 1;
        if (!joins) {
            groups.pivots.push_back(0);
            groups.below.push_back(0);
        }
        groups.group_of[i] = static_cast<int32_t>(groups.pivots.size()) - 1;
        groups.pivots.back() += graph.weight[order[i]];
        groups.below.back() = tree.rows_below[i];
    }
    groups.parent.assign(groups.pivots.size(), -1);
    for (int32_t i = 0; i < n; ++i)
        if (tree.parent[i] >= 0 && groups.group_of[i] != groups.group_of[tree.parent[i]])
            groups.parent[groups.group_of[i]] = groups.group_of[tree.parent[i]];
    return groups;
}

// Joins groups with their parents where that saves time; children first.
void join_groups(Groups& groups) {
    const auto n = static_cast<int32_t>(groups.parent.size());
    std::vector<std::vector<int32_t>> children(n);
    for (int32_t group = 0; group < n; ++group)
        if (groups.parent[group] >= 0) children[groups.parent[group]].push_back(group);
    std::vector<int32_t> joined_to(n, -1);
    for (int32_t group = 0; group < n; ++group) {
        std::stable_sort(children[group].begin(), children[group].end(),
                         [&](int32_t a, int32_t b) { return groups.below[a] > groups.below[b]; });
        for (const int32_t child : children[group]) {
            const auto p = static_cast<double>(groups.pivots[group]);
            const auto u = static_cast<double>(groups.below[group]);
            const auto child_p = static_cast<double>(groups.pivots[child]);
            const auto child_u = static_cast<double>(groups.below[child]);
            if (front_seconds(p + child_p, u) >
                share_of_front_seconds(p, u) + front_seconds(child_p, child_u))
                continue;
            groups.pivots[group] += groups.pivots[child];
            joined_to[child] = group;
        }
    }
    // Joined groups are numbered below what they joined.
    for (int32_t group = n - 1; group >= 0; --group)
        if (joined_to[group] >= 0 && joined_to[joined_to[group]] >= 0)
            joined_to[group] = joined_to[joined_to[group]];
    const auto owner = [&](int32_t group) {
        return joined_to[group] >= 0 ? joined_to[group] : group;
    };
    for (int32_t& group : groups.group_of) group = owner(group);
    for (int32_t& parent : groups.parent)
        if (parent >= 0) parent = owner(parent);
    for (int32_t group = 0; group < n; ++group)
        if (joined_to[group] >= 0) groups.parent[group] = joined_to[group];
}

// Numbers the groups that are left by postorder and the positions group after group.
FrontTree numbered_fronts(const Groups& groups, const std::vector<int32_t>& order) {
    std::vector<std::vector<int32_t>> members(groups.parent.size());
    for (size_t i = 0; i < order.size(); ++i) members[groups.group_of[i]].push_back(order[i]);
    FrontTree tree;
    std::vector<int32_t> front_of(groups.parent.size(), -1);
    for (const int32_t group : postorder(groups.parent)) {
        if (members[group].empty()) continue;
        front_of[group] = static_cast<int32_t>(tree.fronts.size());
        Front front;
        front.first_block = static_cast<int32_t>(tree.order.size());
        tree.order.insert(tree.order.end(), members[group].begin(), members[group].end());
        front.end_block = static_cast<int32_t>(tree.order.size());
        front.num_pivots = groups.pivots[group];
        tree.fronts.push_back(front);
    }
    for (size_t group = 0; group < members.size(); ++group)
        if (front_of[group] >= 0 && groups.parent[group] >= 0)
            tree.fronts[front_of[group]].parent = front_of[groups.parent[group]];
    for (size_t f = 0; f < tree.fronts.size(); ++f)
        if (tree.fronts[f].parent >= 0)
            tree.fronts[tree.fronts[f].parent].children.push_back(static_cast<int32_t>(f));
    return tree;
}

void find_blocks_below(const BlockGraph& graph, FrontTree& tree) {
    const std::vector<int32_t> position = inverse_permutation(tree.order);
    std::vector<int32_t> seen_by(tree.order.size(), -1);
    for (size_t f = 0; f < tree.fronts.size(); ++f) {
        Front& front = tree.fronts[f];
        const auto add = [&](int32_t row) {
            if (row < front.end_block || seen_by[row] == static_cast<int32_t>(f)) return;
            seen_by[row] = static_cast<int32_t>(f);
            front.blocks_below.push_back(row);
            front.num_below += tree.row_begin[row + 1] - tree.row_begin[row];
        };
        for (int32_t i = front.first_block; i < front.end_block; ++i) {
            const int32_t block = tree.order[i];
            for (int64_t k = graph.begin[block]; k < graph.begin[block + 1]; ++k)
                add(position[graph.neighbours[k]]);
        }
        for (const int32_t child : front.children)
            for (const int32_t row : tree.fronts[child].blocks_below) add(row);
        std::sort(front.blocks_below.begin(), front.blocks_below.end());
    }
}

// Runs of a front's rows below in its parent, none across the end of the parent's pivots.
void find_runs(const FrontTree& tree, const Front& parent, Front& front) {
    const std::vector<int64_t> begin_below = rows_of_blocks_below(tree, parent);
    int64_t from = 0;
    for (const int32_t row : front.blocks_below) {
        const int64_t to = row_in_front(tree, parent, begin_below, row);
        const int64_t length = tree.row_begin[row + 1] - tree.row_begin[row];
        const bool continues = !front.runs.empty() && to != parent.num_pivots &&
                               front.runs.back().to + front.runs.back().length == to;
        if (continues)
            front.runs.back().length += static_cast<int32_t>(length);
        else
            front.runs.push_back({static_cast<int32_t>(from), static_cast<int32_t>(to),
                                  static_cast<int32_t>(length)});
        from += length;
    }
}

}  // namespace

std::vector<int64_t> rows_of_blocks_below(const FrontTree& tree, const Front& front) {
    std::vector<int64_t> begin;
    int64_t row = front.num_pivots;
    for (const int32_t position : front.blocks_below) {
        begin.push_back(row);
        row += tree.row_begin[position + 1] - tree.row_begin[position];
    }
    return begin;
}

int64_t row_in_front(const FrontTree& tree, const Front& front,
                     const std::vector<int64_t>& begin_below, int32_t position) {
    if (position < front.end_block)
        return tree.row_begin[position] - tree.row_begin[front.first_block];
    const auto& below = front.blocks_below;
    return begin_below[std::lower_bound(below.begin(), below.end(), position) - below.begin()];
}

FrontTree make_fronts(const BlockGraph& graph, const std::vector<int32_t>& order) {
    // Postorder keeps the structure and makes chains contiguous.
    std::vector<int32_t> reordered;
    for (const int32_t position : postorder(make_tree(graph, order).parent))
        reordered.push_back(order[position]);
    Groups groups = chains(graph, reordered, make_tree(graph, reordered));
    join_groups(groups);
    FrontTree tree = numbered_fronts(groups, reordered);
    tree.row_begin.push_back(0);
    for (const int32_t block : tree.order)
        tree.row_begin.push_back(tree.row_begin.back() + graph.weight[block]);
    find_blocks_below(graph, tree);
    for (Front& front : tree.fronts)
        if (front.parent >= 0) find_runs(tree, tree.fronts[front.parent], front);
    return tree;
}

}  // namespace clba
