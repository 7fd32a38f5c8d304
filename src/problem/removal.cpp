// SPDX-License-Identifier: Apache-2.0
#include "problem/removal.hpp"

#include <utility>

namespace clba {
namespace {

// The rows that a map keeps; of an optional array nothing if it is empty.
template <class Row, class Index>
std::vector<Row> kept_rows(const std::vector<Row>& rows, const std::vector<Index>& map,
                           Index num_kept) {
    std::vector<Row> kept;
    if (rows.empty()) return kept;
    kept.reserve(static_cast<size_t>(num_kept));
    for (size_t i = 0; i < rows.size(); ++i)
        if (map[i] >= 0) kept.push_back(rows[i]);
    return kept;
}

}  // namespace

RowMaps remove_observations(Problem& problem, const std::vector<uint8_t>& goes,
                            bool removes_points) {
    RowMaps maps;
    maps.observations.resize(problem.observations.size());
    std::vector<uint8_t> is_seen(problem.points.size(), !removes_points);
    int64_t num_observations = 0;
    for (size_t i = 0; i < maps.observations.size(); ++i) {
        maps.observations[i] = goes[i] ? -1 : num_observations++;
        if (!goes[i]) is_seen[problem.observations[i].point] = 1;
    }
    maps.points.resize(problem.points.size());
    int32_t num_points = 0;
    for (size_t p = 0; p < maps.points.size(); ++p) maps.points[p] = is_seen[p] ? num_points++ : -1;

    auto observations = kept_rows(problem.observations, maps.observations, num_observations);
    for (Observation& observation : observations)
        observation.point = maps.points[observation.point];
    auto whitening = kept_rows(problem.whitening, maps.observations, num_observations);
    auto points = kept_rows(problem.points, maps.points, num_points);
    auto constant_points = kept_rows(problem.constant_points, maps.points, num_points);
    std::vector<PointPrior> point_priors;
    for (PointPrior prior : problem.priors.points) {
        prior.point = maps.points[prior.point];
        if (prior.point >= 0) point_priors.push_back(prior);
    }
    auto point_uncertainties = kept_rows(problem.point_uncertainties, maps.points, num_points);

    problem.observations = std::move(observations);
    problem.whitening = std::move(whitening);
    problem.points = std::move(points);
    problem.priors.points = std::move(point_priors);
    problem.constant_points = std::move(constant_points);
    problem.point_uncertainties = std::move(point_uncertainties);
    return maps;
}

}  // namespace clba
