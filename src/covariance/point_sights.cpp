// SPDX-License-Identifier: Apache-2.0
#include "covariance/point_sights.hpp"

#include <algorithm>

namespace clba {
namespace {

using Gain = Eigen::Matrix<double, 3, Eigen::Dynamic>;

// J_E^T J_F of an observation, constants left out.
struct Sight {
    int32_t point = 0;  // in the list
    int32_t image = 0;
    Gain product;
};

}  // namespace

std::vector<std::array<double, 6>> download_point_factors(const NormalEquations& equations,
                                                          const DeviceProblem& device) {
    std::vector<std::array<double, 6>> factors(static_cast<size_t>(device.num_points()));
    for (size_t c = 0; c < device.chunks().size(); ++c) {
        const std::vector<int32_t>& slot_point = device.tiles().chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        const auto rows = equations.point_factors()[c].map_read<double>();
        for (int64_t slot = 0; slot < n; ++slot)
            for (int k = 0; k < 6 && slot_point[slot] >= 0; ++k)
                factors[slot_point[slot]][k] = rows[k * n + slot];
    }
    return factors;
}

int rank_of(const std::array<double, 6>& factor) {
    return (factor[0] > 0) + (factor[2] > 0) + (factor[5] > 0);
}

Eigen::Matrix3d inverse_of(const std::array<double, 6>& factor) {
    Eigen::Matrix3d g;
    g << factor[0], 0, 0, factor[1], factor[2], 0, factor[3], factor[4], factor[5];
    return g.transpose() * g;
}

std::vector<PointSights> make_point_sights(const Problem& problem, DeviceProblem& device,
                                           NormalEquations& equations,
                                           const std::vector<std::array<double, 6>>& factors,
                                           const std::vector<int32_t>& points) {
    std::vector<PointSights> all(points.size());
    if (points.empty()) return all;
    std::vector<int32_t> index_of(problem.points.size(), -1);
    for (size_t k = 0; k < points.size(); ++k) {
        index_of[points[k]] = static_cast<int32_t>(k);
        all[k].inverse = inverse_of(factors[points[k]]);
    }
    std::vector<int64_t> sight_of(problem.observations.size(), -1);
    std::vector<Sight> sights;
    for (size_t i = 0; i < problem.observations.size(); ++i) {
        const Observation& observation = problem.observations[i];
        if (index_of[observation.point] < 0) continue;
        sight_of[i] = static_cast<int64_t>(sights.size());
        sights.push_back({index_of[observation.point], observation.image, {}});
    }
    device.visit_slots<double>(equations.jacobian.blocks(), Jacobian::num_block_rows,
                               [&](int64_t observation, int columns, auto&& slot) {
                                   if (sight_of[observation] < 0) return;
                                   Gain& product = sights[sight_of[observation]].product;
                                   product.resize(3, columns);
                                   for (int column = 0; column < columns; ++column)
                                       for (int k = 0; k < 3; ++k)
                                           product(k, column) =
                                               slot(2 * columns + k) * slot(column) +
                                               slot(2 * columns + 3 + k) * slot(columns + column);
                               });

    const ParameterLayout& layout = device.layout();
    std::vector<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> frame_tangents;  // of sensors
    for (const Pose& sensor : problem.rigs.sensors)
        frame_tangents.emplace_back(frame_tangent(sensor).data());
    for (const Sight& sight : sights) {
        PointSights& of_point = all[sight.point];
        const Gain gain = of_point.inverse * sight.product;
        ImagePart parts[ParameterLayout::max_image_parts];
        const int count = layout.parts_of(sight.image, problem.images[sight.image].camera, parts);
        for (int k = 0; k < count; ++k) {
            const ParameterBlock& block = layout.blocks[parts[k].block];
            Gain of_block = gain.middleCols(parts[k].first_column, parts[k].size);
            if (parts[k].is_of_frame)
                of_block = (of_block * frame_tangents[layout.image_sensor[sight.image]]).eval();
            auto part =
                std::find_if(of_point.parts.begin(), of_point.parts.end(),
                             [&](const PointSights::Part& p) { return p.block == parts[k].block; });
            if (part == of_point.parts.end()) {
                of_point.parts.push_back({parts[k].block, Gain::Zero(3, block.size)});
                part = of_point.parts.end() - 1;
            }
            for (int32_t c = 0; c < block.size; ++c)
                if (layout.scale[block.offset + c] > 0) part->gain.col(c) += of_block.col(c);
        }
    }
    return all;
}

}  // namespace clba
