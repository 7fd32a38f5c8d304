// SPDX-License-Identifier: Apache-2.0
#include "problem/fingerprint.hpp"

#include "base/hash.hpp"

namespace clba {
namespace {

uint64_t word(int32_t high, int32_t low) {
    return uint64_t{static_cast<uint32_t>(high)} << 32 | static_cast<uint32_t>(low);
}

template <class Row>
void add_numbers(const std::vector<Row>& rows, Hash& hash) {
    hash.add(uint64_t{rows.size()});
    for (const Row& row : rows)
        for (const double value : row) hash.add(value);
}

template <class Flag>
void add_flags(const std::vector<Flag>& flags, Hash& hash) {
    hash.add(uint64_t{flags.size()});
    for (const Flag flag : flags) hash.add(uint64_t{flag});
}

template <class Numbers>
void add_all(const Numbers& numbers, Hash& hash) {
    for (const double value : numbers) hash.add(value);
}

void add_pose(const Pose& pose, Hash& hash) {
    add_all(pose.rotation, hash);
    add_all(pose.translation, hash);
}

void add_priors(const Priors& priors, Hash& hash) {
    for (const size_t size :
         {priors.positions.size(), priors.poses.size(), priors.intrinsics.size(),
          priors.points.size(), priors.relative_poses.size()})
        hash.add(uint64_t{size});
    for (const PositionPrior& prior : priors.positions) {
        hash.add(word(0, prior.image));
        add_all(prior.position, hash);
        add_all(prior.whitening, hash);
    }
    for (const PosePrior& prior : priors.poses) {
        hash.add(word(0, prior.image));
        add_pose(prior.pose, hash);
        add_all(prior.whitening, hash);
    }
    for (const IntrinsicsPrior& prior : priors.intrinsics) {
        hash.add(word(0, prior.camera));
        add_all(prior.params, hash);
        add_all(prior.whitening, hash);
    }
    for (const PointPrior& prior : priors.points) {
        hash.add(word(0, prior.point));
        add_all(prior.position, hash);
        add_all(prior.whitening, hash);
    }
    for (const RelativePosePrior& prior : priors.relative_poses) {
        hash.add(word(prior.first, prior.second));
        add_pose(prior.pose, hash);
        add_all(prior.whitening, hash);
    }
}

}  // namespace

uint64_t fingerprint(const Problem& problem) {
    Hash hash;
    for (const size_t size : {problem.cameras.size(), problem.images.size(), problem.points.size(),
                              problem.observations.size()})
        hash.add(uint64_t{size});
    for (const Camera& camera : problem.cameras) hash.add(word(0, camera.model));
    for (const Image& image : problem.images) hash.add(word(0, image.camera));
    for (const Observation& observation : problem.observations) {
        hash.add(word(observation.image, observation.point));
        hash.add(observation.x);
        hash.add(observation.y);
    }
    add_numbers(problem.whitening, hash);
    add_flags(problem.constant_images, hash);
    add_flags(problem.constant_cameras, hash);
    add_flags(problem.constant_points, hash);
    add_numbers(problem.image_uncertainties, hash);
    add_numbers(problem.camera_uncertainties, hash);
    add_numbers(problem.point_uncertainties, hash);
    add_priors(problem.priors, hash);
    if (!problem.rigs.empty()) {  // so that problems without keep the number they had
        for (size_t i = 0; i < problem.images.size(); ++i)
            hash.add(word(problem.rigs.image_frame[i], problem.rigs.image_sensor[i]));
        add_flags(problem.rigs.constant_frames, hash);
        add_flags(problem.rigs.constant_sensors, hash);
    }
    hash.add(word(0, static_cast<int32_t>(problem.loss.kind)));
    hash.add(problem.loss.scale);
    return hash.value();
}

}  // namespace clba
