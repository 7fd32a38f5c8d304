// SPDX-License-Identifier: Apache-2.0
#include "io/reconstruction.hpp"

#include <algorithm>
#include <cstring>
#include <tuple>
#include <utility>

namespace clba {
namespace {

class Digest {
public:
    void add(uint64_t word) {  // the finaliser of MurmurHash3 on a running sum
        hash_ = (hash_ ^ word) * 0xff51afd7ed558ccdu;
        hash_ ^= hash_ >> 33;
    }
    void add(double value) {
        uint64_t bits;
        std::memcpy(&bits, &value, sizeof bits);
        add(bits);
    }
    uint64_t value() const { return hash_ ? hash_ : 1; }

private:
    uint64_t hash_ = 0x9e3779b97f4a7c15u;
};

template <class Info>
bool extend(std::vector<Info>& infos, size_t num_rows) {
    if (infos.empty() || infos.size() >= num_rows) return false;
    uint64_t id = 0;
    for (const Info& info : infos) id = std::max(id, info.id);
    infos.reserve(std::max(num_rows, 2 * infos.capacity()));
    while (infos.size() < num_rows) {
        infos.emplace_back();
        infos.back().id = ++id;
    }
    return true;
}

}  // namespace

uint64_t digest(const Problem& problem) {
    Digest digest;
    for (const Camera& camera : problem.cameras) {
        digest.add(static_cast<uint64_t>(camera.model));
        for (int k = 0; k < camera.num_params(); ++k) digest.add(camera.params[k]);
    }
    for (const Image& image : problem.images) {
        digest.add(static_cast<uint64_t>(image.camera));
        for (double value : image.pose.rotation) digest.add(value);
        for (double value : image.pose.translation) digest.add(value);
    }
    for (const Point& point : problem.points)
        for (double value : point) digest.add(value);
    const Rigs& rigs = problem.rigs;
    for (size_t i = 0; i < rigs.image_frame.size(); ++i) {
        digest.add(static_cast<uint64_t>(rigs.image_frame[i]));
        digest.add(static_cast<uint64_t>(rigs.image_sensor[i]));
    }
    for (const std::vector<Pose>* poses : {&rigs.frames, &rigs.sensors})
        for (const Pose& pose : *poses) {
            for (double value : pose.rotation) digest.add(value);
            for (double value : pose.translation) digest.add(value);
        }
    return digest.value();
}

RowMaps remove_observations(Reconstruction& reconstruction, const std::vector<uint8_t>& goes,
                            bool removes_points) {
    const Problem& problem = reconstruction.problem;
    std::vector<Feature> unmatched = reconstruction.unmatched;
    if (!reconstruction.observation_features.empty()) {
        for (size_t i = 0; i < goes.size(); ++i) {
            const Observation& o = problem.observations[i];
            if (goes[i])
                unmatched.push_back({o.image, reconstruction.observation_features[i], o.x, o.y});
        }
        std::sort(unmatched.begin(), unmatched.end(), [](const Feature& a, const Feature& b) {
            return std::tie(a.image, a.index) < std::tie(b.image, b.index);
        });
    }
    std::vector<int32_t> features = reconstruction.observation_features;
    std::vector<PointInfo> points = reconstruction.points;
    const RowMaps maps = remove_observations(reconstruction.problem, goes, removes_points);
    // What follows only shortens vectors in place, and so cannot fail.
    const auto keep = [](auto& rows, const auto& map) {
        if (rows.empty()) return;
        size_t next = 0;
        for (size_t i = 0; i < map.size(); ++i)
            if (map[i] >= 0) rows[next++] = std::move(rows[i]);
        rows.erase(rows.begin() + static_cast<std::ptrdiff_t>(next), rows.end());
    };
    keep(features, maps.observations);
    keep(points, maps.points);
    reconstruction.observation_features = std::move(features);
    reconstruction.points = std::move(points);
    reconstruction.unmatched = std::move(unmatched);
    reconstruction.digest_read = 0;
    return maps;
}

void extend_infos(Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    extend(reconstruction.cameras, problem.cameras.size());
    extend(reconstruction.points, problem.points.size());
    if (!extend(reconstruction.images, problem.images.size())) return;
    reconstruction.poses_read.clear();
    reconstruction.has_frames = false;
    reconstruction.rigs.clear();
    reconstruction.frames.clear();
}

void drop_mismatched(Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    const auto differ = [](size_t kept, size_t rows) { return kept > 0 && kept != rows; };
    if (differ(reconstruction.cameras.size(), problem.cameras.size()) ||
        differ(reconstruction.images.size(), problem.images.size()) ||
        differ(reconstruction.points.size(), problem.points.size()))
        reconstruction.details = nullptr;
    if (reconstruction.cameras.size() != problem.cameras.size()) reconstruction.cameras.clear();
    if (reconstruction.images.size() != problem.images.size()) {
        reconstruction.images.clear();
        reconstruction.poses_read.clear();
        reconstruction.unmatched.clear();
    }
    if (reconstruction.points.size() != problem.points.size()) reconstruction.points.clear();
    if (reconstruction.observation_features.size() != problem.observations.size()) {
        reconstruction.observation_features.clear();
        reconstruction.unmatched.clear();
    }
    if (reconstruction.cameras.empty() || reconstruction.images.empty()) {
        reconstruction.has_frames = false;
        reconstruction.rigs.clear();
        reconstruction.frames.clear();
    }
}

}  // namespace clba
