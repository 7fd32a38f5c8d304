// SPDX-License-Identifier: Apache-2.0
#include "reference/direct_schur.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "reference/priors.hpp"
#include "reference/sparse_cholesky.hpp"

namespace clba::reference {
namespace {

constexpr int max_block_size = num_pose_params + max_camera_params;
using Columns = std::array<double*, max_block_size>;

template <int Size>
using Vector = Eigen::Matrix<double, Size, 1>;

// Calls work(integral_constant) with the size if it is a common one, or else with Eigen::Dynamic.
template <class Work>
void with_size(int size, const Work& work) {
    switch (size) {
        case 6:
            return work(std::integral_constant<int, 6>());
        case 9:
            return work(std::integral_constant<int, 9>());
        case 10:
            return work(std::integral_constant<int, 10>());
        default:
            return work(std::integral_constant<int, Eigen::Dynamic>());
    }
}

// out += left^T right for 2 x rows and 2 x columns blocks, given by their two rows; out is
// rows x columns, column-major.
template <int Rows>
void add_product(int num_rows, int num_columns, const double* left0, const double* left1,
                 const double* right0, const double* right1, double* out) {
    const Eigen::Map<const Vector<Rows>> a(left0, num_rows);
    const Eigen::Map<const Vector<Rows>> b(left1, num_rows);
    for (int c = 0; c < num_columns; ++c)
        Eigen::Map<Vector<Rows>>(out + c * num_rows, num_rows) += right0[c] * a + right1[c] * b;
}

// out -= left right^T for column-major rows x 3 and columns x 3 matrices; column c of out begins at
// out[c] + offset.
template <int Rows>
void subtract_product(int num_rows, int num_columns, const double* left, const double* right,
                      const Columns& out, int64_t offset) {
    const Eigen::Map<const Vector<Rows>> a(left, num_rows);
    const Eigen::Map<const Vector<Rows>> b(left + num_rows, num_rows);
    const Eigen::Map<const Vector<Rows>> d(left + 2 * num_rows, num_rows);
    for (int c = 0; c < num_columns; ++c)
        Eigen::Map<Vector<Rows>>(out[c] + offset, num_rows) -=
            right[c] * a + right[num_columns + c] * b + right[2 * num_columns + c] * d;
}

// The columns of an image's pose become those of its frame or its sensor, two rows after each
// other; tangent is A of frame_tangent, NULL: I. Constants get 0.
void rig_columns(const double* row0, const double* row1, const std::array<double, 36>* tangent,
                 const double* scale, double* rows) {
    for (int c = 0; c < num_pose_params; ++c) {
        double sum0 = row0[c], sum1 = row1[c];
        if (tangent) {
            sum0 = sum1 = 0;
            for (int k = 0; k < num_pose_params; ++k) {
                sum0 += row0[k] * (*tangent)[6 * k + c];
                sum1 += row1[k] * (*tangent)[6 * k + c];
            }
        }
        rows[c] = scale[c] > 0 ? sum0 : 0;
        rows[num_pose_params + c] = scale[c] > 0 ? sum1 : 0;
    }
}

// The next KiB: a point's slots follow each other, but an image's points are far apart.
void prefetch(const double* data) {
    for (int k = 0; k < 128; k += 8) __builtin_prefetch(data + k);
}

// V = L L^T of a point.
struct PointFactor {
    double l10, l20, l21;
    std::array<double, 3> inverse;  // 1 / l00, 1 / l11, 1 / l22

    // v: column-major 3 x 3. False: not positive definite or not finite.
    bool factorize(const std::array<double, 9>& v) {
        const auto pivot = [this](int k, double squared) {
            inverse[k] = 1 / std::sqrt(squared);
            return squared > 0 && std::isfinite(squared);
        };
        if (!pivot(0, v[0])) return false;
        l10 = v[1] * inverse[0];
        l20 = v[2] * inverse[0];
        if (!pivot(1, v[4] - l10 * l10)) return false;
        l21 = (v[5] - l20 * l10) * inverse[1];
        return pivot(2, v[8] - l20 * l20 - l21 * l21);
    }
    // L^-1 on three numbers that are `stride` apart.
    void solve_lower(double* x, int stride) const {
        x[0] *= inverse[0];
        x[stride] = (x[stride] - l10 * x[0]) * inverse[1];
        x[2 * stride] = (x[2 * stride] - l20 * x[0] - l21 * x[stride]) * inverse[2];
    }
    // L^-T
    void solve_upper(double* x) const {
        x[2] *= inverse[2];
        x[1] = (x[1] - l21 * x[2]) * inverse[1];
        x[0] = (x[0] - l10 * x[1] - l20 * x[2]) * inverse[0];
    }
};

// Where the items of each of num_keys keys begin in a list ordered by key; num_keys + 1 numbers.
template <class Key>
std::vector<int64_t> count_starts(int64_t num_items, size_t num_keys, const Key& key_of) {
    std::vector<int64_t> starts(num_keys + 1, 0);
    for (int64_t i = 0; i < num_items; ++i) ++starts[size_t{1} + key_of(i)];
    std::partial_sum(starts.begin(), starts.end(), starts.begin());
    return starts;
}

}  // namespace

// What stays the same between solves. A slot is a free point with a free block that observes it:
// the slots of a point follow each other, blocks ascending.
struct DirectSchur::Structure {
    struct BlockSlot {
        int64_t slot;
        int64_t end;  // of its point's slots
    };
    // The free blocks of an image, ascending, and for each pair (a, b) of them, a before b, the
    // number of J_b^T J_a at [a + b - 1].
    struct ImageBlocks {
        int num_parts = 0;
        int32_t sensor = -1;  // of a composed image
        std::array<ImagePart, ParameterLayout::max_image_parts> parts;
        std::array<int32_t, ParameterLayout::max_image_parts> cross{-1, -1, -1};
    };
    // J_later^T J_earlier of two blocks that observations have in common.
    struct Cross {
        int32_t earlier, later;
        int64_t start = 0;
    };

    Structure(const Problem& problem, const ParameterLayout& layout) {
        find_blocks(problem, layout);
        find_crosses(problem);
        find_slots(problem);
        find_priors(problem, layout);
        find_neighbours();
    }

    std::vector<ParameterBlock> blocks;
    std::vector<double> scale;           // of each F scalar; 0: constant
    std::vector<uint8_t> is_free_block;  // 0: all its scalars are constant
    std::vector<int64_t> product_start;  // of each block's size x size numbers; blocks + 1
    std::vector<ImageBlocks> images;
    std::vector<Cross> crosses;        // by their earlier block
    std::vector<int64_t> cross_begin;  // of each block; blocks + 1
    std::vector<uint8_t> is_free_point;
    int32_t num_f = 0;
    int64_t num_cross = 0;  // numbers of all crosses
    int64_t slot_size = 0;  // 3 x the largest block

    std::vector<int64_t> observation_start;  // of each point; points + 1
    std::vector<int64_t> observation;        // by point
    // Of each part of an observation's image, max_parts an observation; -1: the point is constant.
    std::vector<int64_t> observation_slots;
    int max_parts = 2;
    std::vector<int64_t> slot_start;  // of each point; points + 1
    std::vector<int32_t> slot_block;
    std::vector<int64_t> block_slot_start;  // of each block; blocks + 1
    std::vector<BlockSlot> block_slots;
    std::vector<int64_t> neighbour_start;  // of each block; blocks + 1
    std::vector<int32_t> neighbours;       // later blocks that S couples it to, ascending

    std::vector<int32_t> point_prior;                // of each point, -1: none; or empty
    std::vector<std::array<double, 9>> information;  // of each prior of a point
    struct PriorEntry {
        int32_t row, column;  // of S, row >= column
        int32_t source;       // in the values of P
    };
    std::vector<PriorEntry> prior_entries;

    int64_t num_points() const { return static_cast<int64_t>(is_free_point.size()); }
    SparseCholesky analyze() const;

private:
    void find_blocks(const Problem& problem, const ParameterLayout& layout);
    void find_crosses(const Problem& problem);
    void find_slots(const Problem& problem);
    void find_neighbours();
    void find_priors(const Problem& problem, const ParameterLayout& layout);
};

void DirectSchur::Structure::find_blocks(const Problem& problem, const ParameterLayout& layout) {
    blocks = layout.blocks;
    scale = layout.scale;
    num_f = layout.num_f;
    if (layout.has_rigs()) max_parts = ParameterLayout::max_image_parts;
    images.resize(problem.images.size());
    product_start.push_back(0);
    for (size_t b = 0; b < blocks.size(); ++b) {
        const ParameterBlock& block = blocks[b];
        const double* first = scale.data() + block.offset;
        is_free_block.push_back(
            std::any_of(first, first + block.size, [](double s) { return s > 0; }));
        product_start.push_back(product_start.back() + block.size * block.size);
        slot_size = std::max(slot_size, int64_t{3} * block.size);
    }
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        std::array<ImagePart, ParameterLayout::max_image_parts> parts;
        const int count = layout.parts_of(i, problem.images[i].camera, parts.data());
        ImageBlocks& image = images[i];
        image.sensor = layout.is_composed(i) ? layout.image_sensor[i] : -1;
        for (int k = 0; k < count; ++k)
            if (is_free_block[parts[k].block]) image.parts[image.num_parts++] = parts[k];
    }
    for (int32_t p = 0; p < problem.num_points(); ++p)
        is_free_point.push_back(point_scale(problem, p)[0] > 0);
}

// Of images that have observations.
void DirectSchur::Structure::find_crosses(const Problem& problem) {
    std::vector<char> is_listed(images.size(), 0);
    std::vector<int32_t> listed;
    for (const Observation& seen : problem.observations)
        if (!std::exchange(is_listed[seen.image], char{1})) listed.push_back(seen.image);
    const auto for_each_pair = [&](auto&& visit) {
        for (const int32_t i : listed)
            for (int b = 1; b < images[i].num_parts; ++b)
                for (int a = 0; a < b; ++a)
                    visit(images[i].parts[a].block, images[i].parts[b].block,
                          images[i].cross[a + b - 1]);
    };
    const auto is_before = [](const Cross& x, const Cross& y) {
        return std::pair(x.earlier, x.later) < std::pair(y.earlier, y.later);
    };
    for_each_pair([&](int32_t a, int32_t b, int32_t&) { crosses.push_back({a, b}); });
    std::sort(crosses.begin(), crosses.end(), is_before);
    crosses.erase(std::unique(crosses.begin(), crosses.end(),
                              [](const Cross& x, const Cross& y) {
                                  return x.earlier == y.earlier && x.later == y.later;
                              }),
                  crosses.end());
    for (Cross& cross : crosses) {
        cross.start = num_cross;
        num_cross += int64_t{blocks[cross.earlier].size} * blocks[cross.later].size;
    }
    for_each_pair([&](int32_t a, int32_t b, int32_t& number) {
        number = static_cast<int32_t>(
            std::lower_bound(crosses.begin(), crosses.end(), Cross{a, b}, is_before) -
            crosses.begin());
    });
    cross_begin = count_starts(static_cast<int64_t>(crosses.size()), blocks.size(),
                               [&](int64_t k) { return crosses[k].earlier; });
}

void DirectSchur::Structure::find_slots(const Problem& problem) {
    const auto point_of = [&](int64_t i) { return problem.observations[i].point; };
    observation_start = count_starts(problem.num_observations(), problem.points.size(), point_of);
    observation.resize(problem.observations.size());
    std::vector<int64_t> next = observation_start;
    for (int64_t i = 0; i < problem.num_observations(); ++i) observation[next[point_of(i)]++] = i;
    observation_slots.assign(observation.size() * static_cast<size_t>(max_parts), -1);

    std::vector<int64_t> slot_of(blocks.size(), -1);  // of the current point; reset after it
    std::vector<int32_t> track;
    slot_start.push_back(0);
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        const int64_t begin = observation_start[p];
        const int64_t end = is_free_point[p] ? observation_start[p + 1] : begin;
        track.clear();
        const auto add = [&](int32_t block) {
            if (slot_of[block] >= 0) return;
            slot_of[block] = 0;
            track.push_back(block);
        };
        for (int64_t k = begin; k < end; ++k) {
            const ImageBlocks& image = images[problem.observations[observation[k]].image];
            for (int part = 0; part < image.num_parts; ++part) add(image.parts[part].block);
        }
        std::sort(track.begin(), track.end());
        for (const int32_t block : track) {
            slot_of[block] = static_cast<int64_t>(slot_block.size());
            slot_block.push_back(block);
        }
        slot_start.push_back(static_cast<int64_t>(slot_block.size()));
        for (int64_t k = begin; k < end; ++k) {
            const ImageBlocks& image = images[problem.observations[observation[k]].image];
            for (int part = 0; part < image.num_parts; ++part)
                observation_slots[max_parts * k + part] = slot_of[image.parts[part].block];
        }
        for (const int32_t block : track) slot_of[block] = -1;
    }

    block_slot_start = count_starts(slot_start.back(), blocks.size(),
                                    [&](int64_t slot) { return slot_block[slot]; });
    block_slots.resize(slot_block.size());
    next = block_slot_start;
    for (int64_t p = 0; p < num_points(); ++p)
        for (int64_t slot = slot_start[p]; slot < slot_start[p + 1]; ++slot)
            block_slots[next[slot_block[slot]]++] = {slot, slot_start[p + 1]};
}

void DirectSchur::Structure::find_neighbours() {
    std::vector<int32_t> found_for(blocks.size(), -1);
    std::vector<std::vector<int32_t>> later(prior_entries.empty() ? 0 : blocks.size());
    std::vector<int32_t> block_of(later.empty() ? 0 : static_cast<size_t>(num_f));
    for (size_t b = 0; b < later.size(); ++b)
        std::fill_n(block_of.begin() + blocks[b].offset, blocks[b].size, static_cast<int32_t>(b));
    for (const PriorEntry& entry : prior_entries)
        if (block_of[entry.row] != block_of[entry.column])
            later[block_of[entry.column]].push_back(block_of[entry.row]);
    neighbour_start.push_back(0);
    for (size_t b = 0; b < blocks.size(); ++b) {
        const auto add = [&](int32_t neighbour) {
            if (found_for[neighbour] == static_cast<int32_t>(b)) return;
            found_for[neighbour] = static_cast<int32_t>(b);
            neighbours.push_back(neighbour);
        };
        for (int64_t k = block_slot_start[b]; k < block_slot_start[b + 1]; ++k) {
            const auto [own, end] = block_slots[k];
            for (int64_t slot = own + 1; slot < end; ++slot) add(slot_block[slot]);
        }
        // Where points are all constant there are no slots in common.
        for (int64_t k = cross_begin[b]; k < cross_begin[b + 1]; ++k) add(crosses[k].later);
        if (!later.empty())
            for (int32_t block : later[b]) add(block);
        std::sort(neighbours.begin() + neighbour_start[b], neighbours.end());
        neighbour_start.push_back(static_cast<int64_t>(neighbours.size()));
    }
}

void DirectSchur::Structure::find_priors(const Problem& problem, const ParameterLayout& layout) {
    if (!problem.priors.points.empty()) point_prior.assign(problem.points.size(), -1);
    for (const PointPrior& prior : problem.priors.points) {
        point_prior[prior.point] = static_cast<int32_t>(information.size());
        add_information(prior, information.emplace_back().data());
    }
    if (!problem.priors.has_image_side()) return;
    const ImagePriors priors(problem, layout);
    for (size_t i = 0; i < priors.rows().size(); ++i)
        for (int32_t k = priors.row_begin()[i]; k < priors.row_begin()[i + 1]; ++k)
            if (priors.columns()[k] <= priors.rows()[i])
                prior_entries.push_back({priors.rows()[i], priors.columns()[k], k});
}

// Lower triangle of S by columns: a column has the rest of its own block, then its neighbours.
SparseCholesky DirectSchur::Structure::analyze() const {
    int64_t num_entries = 0;
    for (size_t b = 0; b < blocks.size(); ++b) {
        int64_t num_rows_below = 0;
        for (int64_t k = neighbour_start[b]; k < neighbour_start[b + 1]; ++k)
            num_rows_below += blocks[neighbours[k]].size;
        const int64_t size = blocks[b].size;
        num_entries += size * (size + 1) / 2 + size * num_rows_below;
    }
    std::vector<int64_t> starts{0};
    std::vector<int64_t> rows;
    rows.reserve(num_entries);
    for (size_t b = 0; b < blocks.size(); ++b) {
        const auto add_rows = [&](const ParameterBlock& block, int first) {
            for (int r = first; r < block.size; ++r) rows.push_back(block.offset + r);
        };
        for (int c = 0; c < blocks[b].size; ++c) {
            add_rows(blocks[b], c);
            for (int64_t k = neighbour_start[b]; k < neighbour_start[b + 1]; ++k)
                add_rows(blocks[neighbours[k]], 0);
            starts.push_back(static_cast<int64_t>(rows.size()));
        }
    }
    return {std::move(starts), std::move(rows)};
}

// What each solve computes anew.
struct DirectSchur::Numbers {
    explicit Numbers(const Structure& structure);
    void start(const Jacobian& jacobian, const double* gradient);
    void add_observations(const Jacobian& jacobian, int64_t point);
    bool eliminate(int64_t point, const double* gradient, const double* damping);
    void fill_columns(int32_t block, const double* damping);
    void add_priors(const std::vector<double>& image_priors);
    void back_substitute(int64_t point, const double* delta_f, double* delta_e) const;

    const Structure& s;
    SparseCholesky cholesky;
    std::vector<double> slots;     // W, then Z, of each slot: size x 3, column-major
    std::vector<double> products;  // U of each block, column-major
    std::vector<double> cross;     // of each of the structure's crosses, column-major
    std::array<double, 9> v{};     // of the current point
    std::vector<PointFactor> factors;
    std::vector<std::array<double, 3>> y;  // of each point
    std::vector<double> right;             // b
    std::vector<double> values;            // of S
    std::vector<int64_t> row_offset;       // of each neighbour of the current block in its columns
    std::vector<std::array<double, 36>> tangents;  // frame_tangent of each sensor
    int64_t num_indefinite = 0;
};

DirectSchur::Numbers::Numbers(const Structure& structure)
    : s(structure),
      cholesky(s.analyze()),
      slots(s.slot_block.size() * s.slot_size),
      products(s.product_start.back()),
      cross(s.num_cross),
      factors(s.num_points()),
      y(s.num_points()),
      right(s.num_f),
      values(cholesky.column_starts().back()),
      row_offset(s.blocks.size()) {}

void DirectSchur::Numbers::start(const Jacobian& jacobian, const double* gradient) {
    num_indefinite = 0;
    tangents.clear();
    for (const Pose& sensor : jacobian.sensors) tangents.push_back(frame_tangent(sensor));
    std::fill(slots.begin(), slots.end(), 0.0);
    std::fill(products.begin(), products.end(), 0.0);
    std::fill(cross.begin(), cross.end(), 0.0);
    for (int32_t k = 0; k < s.num_f; ++k) right[k] = s.scale[k] > 0 ? -gradient[k] : 0;
}

// U, W and V from a point's observations.
void DirectSchur::Numbers::add_observations(const Jacobian& jacobian, int64_t point) {
    v.fill(0);
    if (!s.point_prior.empty() && s.point_prior[point] >= 0)
        v = s.information[s.point_prior[point]];
    const int columns = jacobian.columns;
    for (int64_t k = s.observation_start[point]; k < s.observation_start[point + 1]; ++k) {
        const int64_t i = s.observation[k];
        const double* f0 = jacobian.image_blocks.data() + i * 2 * columns;
        const double* f1 = f0 + columns;
        const double* e0 = jacobian.point_blocks.data() + i * 6;
        const double* e1 = e0 + 3;
        add_product<3>(3, 3, e0, e1, e0, e1, v.data());

        const Structure::ImageBlocks& image = s.images[jacobian.image[i]];
        std::array<std::array<double, 2 * num_pose_params>, 2> of_rig;  // of frame and sensor
        struct {
            const double *row0, *row1;
            int size;
        } of_part[ParameterLayout::max_image_parts];
        for (int part = 0; part < image.num_parts; ++part) {
            const ImagePart& columns_of = image.parts[part];
            const ParameterBlock& block = s.blocks[columns_of.block];
            auto& [row0, row1, size] = of_part[part];
            row0 = f0 + columns_of.first_column;
            row1 = f1 + columns_of.first_column;
            size = columns_of.size;
            if (block.frame >= 0 || block.sensor >= 0) {
                double* rows = of_rig[columns_of.is_of_frame ? 0 : 1].data();
                rig_columns(row0, row1, columns_of.is_of_frame ? &tangents[image.sensor] : nullptr,
                            s.scale.data() + block.offset, rows);
                row0 = rows;
                row1 = rows + num_pose_params;
            }
            double* u = products.data() + s.product_start[columns_of.block];
            const int64_t slot = s.observation_slots[s.max_parts * k + part];
            with_size(size, [&, row0 = row0, row1 = row1, size = size](auto n) {
                add_product<n>(size, size, row0, row1, row0, row1, u);
                if (slot >= 0)
                    add_product<n>(size, 3, row0, row1, e0, e1, slots.data() + slot * s.slot_size);
            });
            for (int a = 0; a < part; ++a)
                add_product<Eigen::Dynamic>(
                    size, of_part[a].size, row0, row1, of_part[a].row0, of_part[a].row1,
                    cross.data() + s.crosses[image.cross[a + part - 1]].start);
        }
    }
}

// Z and the point's part of b. False: V is not positive definite.
bool DirectSchur::Numbers::eliminate(int64_t point, const double* gradient, const double* damping) {
    const int64_t first = s.num_f + 3 * point;
    for (int k = 0; k < 3; ++k) v[4 * k] += damping[first + k];
    PointFactor& factor = factors[point];
    if (!factor.factorize(v)) return false;
    std::array<double, 3>& right_e = y[point];
    for (int k = 0; k < 3; ++k) right_e[k] = -gradient[first + k];
    factor.solve_lower(right_e.data(), 1);
    for (int64_t slot = s.slot_start[point]; slot < s.slot_start[point + 1]; ++slot) {
        const ParameterBlock& block = s.blocks[s.slot_block[slot]];
        double* z = slots.data() + slot * s.slot_size;
        double* b = right.data() + block.offset;
        for (int r = 0; r < block.size; ++r) {
            factor.solve_lower(z + r, block.size);
            b[r] -= z[r] * right_e[0] + z[block.size + r] * right_e[1] +
                    z[2 * block.size + r] * right_e[2];
        }
    }
    return true;
}

// The columns of S of one block.
void DirectSchur::Numbers::fill_columns(int32_t block, const double* damping) {
    const ParameterBlock& own = s.blocks[block];
    const int64_t* starts = cholesky.column_starts().data() + own.offset;
    double* product = products.data() + s.product_start[block];
    Columns diagonal{};
    Columns below{};
    for (int c = 0; c < own.size; ++c) {
        diagonal[c] = product + c * own.size;
        below[c] = values.data() + starts[c] + (own.size - c);
        std::fill(below[c], values.data() + starts[c + 1], 0.0);
    }
    int64_t offset = 0;
    for (int64_t k = s.neighbour_start[block]; k < s.neighbour_start[block + 1]; ++k) {
        row_offset[s.neighbours[k]] = offset;
        offset += s.blocks[s.neighbours[k]].size;
    }
    for (int64_t k = s.cross_begin[block]; k < s.cross_begin[block + 1]; ++k) {
        const int32_t later = s.crosses[k].later;
        const int size = s.blocks[later].size;
        const double* from = cross.data() + s.crosses[k].start;
        for (int c = 0; c < own.size; ++c)
            std::copy_n(from + c * size, size, below[c] + row_offset[later]);
    }

    for (int64_t k = s.block_slot_start[block]; k < s.block_slot_start[block + 1]; ++k) {
        if (k + 3 < s.block_slot_start[block + 1])
            prefetch(slots.data() + s.block_slots[k + 3].slot * s.slot_size);
        const auto [slot, end] = s.block_slots[k];
        const double* z = slots.data() + slot * s.slot_size;
        with_size(own.size,
                  [&](auto n) { subtract_product<n>(own.size, own.size, z, z, diagonal, 0); });
        for (int64_t other = slot + 1; other < end; ++other) {
            const int32_t neighbour = s.slot_block[other];
            const int size = s.blocks[neighbour].size;
            const double* other_z = slots.data() + other * s.slot_size;
            with_size(size, [&](auto n) {
                subtract_product<n>(size, own.size, other_z, z, below, row_offset[neighbour]);
            });
        }
    }

    for (int c = 0; c < own.size; ++c) {
        const bool is_free = s.scale[own.offset + c] > 0;
        double* column = values.data() + starts[c];
        std::copy(diagonal[c] + c, diagonal[c] + own.size, column);
        column[0] = is_free ? column[0] + damping[own.offset + c] : 1;
    }
}

void DirectSchur::Numbers::add_priors(const std::vector<double>& image_priors) {
    for (const Structure::PriorEntry& entry : s.prior_entries) {
        const auto begin = cholesky.rows().begin() + cholesky.column_starts()[entry.column];
        const auto end = cholesky.rows().begin() + cholesky.column_starts()[entry.column + 1];
        const auto at = std::lower_bound(begin, end, entry.row);
        values[at - cholesky.rows().begin()] += image_priors[entry.source];
    }
}

void DirectSchur::Numbers::back_substitute(int64_t point, const double* delta_f,
                                           double* delta_e) const {
    std::array<double, 3> x = y[point];
    for (int64_t slot = s.slot_start[point]; slot < s.slot_start[point + 1]; ++slot) {
        const ParameterBlock& block = s.blocks[s.slot_block[slot]];
        const double* z = slots.data() + slot * s.slot_size;
        const double* d = delta_f + block.offset;
        for (int c = 0; c < 3; ++c)
            x[c] -= std::inner_product(d, d + block.size, z + c * block.size, 0.0);
    }
    factors[point].solve_upper(x.data());
    std::copy(x.begin(), x.end(), delta_e);
}

DirectSchur::DirectSchur(const Problem& problem, const ParameterLayout& layout)
    : structure_(std::make_unique<Structure>(problem, layout)),
      numbers_(std::make_unique<Numbers>(*structure_)) {}

DirectSchur::~DirectSchur() = default;

bool DirectSchur::solve(const Jacobian& jacobian, const double* gradient, const double* damping,
                        const std::vector<double>& image_priors, double* delta) {
    const Structure& s = *structure_;
    Numbers& numbers = *numbers_;
    const auto num_observations = static_cast<int64_t>(s.observation.size());
    require(jacobian.num_observations() == num_observations, "the Jacobian has ",
            jacobian.num_observations(), " observations, but the problem has ", num_observations);

    numbers.start(jacobian, gradient);
    for (int64_t p = 0; p < s.num_points(); ++p) {
        numbers.add_observations(jacobian, p);
        if (s.is_free_point[p] && !numbers.eliminate(p, gradient, damping))
            ++numbers.num_indefinite;
    }
    if (numbers.num_indefinite > 0) return false;

    for (size_t b = 0; b < s.blocks.size(); ++b)
        numbers.fill_columns(static_cast<int32_t>(b), damping);
    numbers.add_priors(image_priors);
    if (!numbers.cholesky.factorize(numbers.values.data())) {
        numbers.num_indefinite = 1;
        return false;
    }
    numbers.cholesky.solve(numbers.right.data(), delta);
    for (int64_t p = 0; p < s.num_points(); ++p) {
        double* delta_e = delta + s.num_f + 3 * p;
        if (s.is_free_point[p])
            numbers.back_substitute(p, delta, delta_e);
        else
            std::fill_n(delta_e, 3, 0.0);
    }
    return std::all_of(delta, delta + s.num_f + 3 * s.num_points(),
                       [](double d) { return std::isfinite(d); });
}

int64_t DirectSchur::num_indefinite() const {
    return numbers_->num_indefinite;
}

int64_t DirectSchur::num_schur_nonzeros() const {
    return static_cast<int64_t>(numbers_->values.size());
}

int64_t DirectSchur::num_factor_nonzeros() const {
    return numbers_->cholesky.num_factor_nonzeros();
}

}  // namespace clba::reference
