// SPDX-License-Identifier: Apache-2.0
#include "io/reconstruction.hpp"

#include <cstring>

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
    return digest.value();
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
