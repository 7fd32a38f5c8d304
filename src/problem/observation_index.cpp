// SPDX-License-Identifier: Apache-2.0
#include "problem/observation_index.hpp"

#include "problem/point_order.hpp"

namespace clba {

void ObservationIndex::extend(const Problem& problem) {
    const auto num_observations = static_cast<int32_t>(require_countable(problem));
    of_image_.latest.resize(problem.images.size(), -1);
    of_point_.latest.resize(problem.points.size(), -1);
    num_users_.resize(problem.cameras.size(), 0);
    for (; num_images_ < problem.num_images(); ++num_images_)
        ++num_users_[problem.images[num_images_].camera];
    extend_rigs(problem);
    for (auto i = static_cast<int32_t>(of_image_.before.size()); i < num_observations; ++i) {
        of_image_.add(problem.observations[i].image, i);
        of_point_.add(problem.observations[i].point, i);
    }
}

void ObservationIndex::list_rigs(const Problem& problem) {
    of_frame_ = Chains();
    num_sensor_users_.clear();
    num_listed_images_ = 0;
    extend_rigs(problem);
}

void ObservationIndex::extend_rigs(const Problem& problem) {
    const Rigs& rigs = problem.rigs;
    if (rigs.empty()) return;
    of_frame_.latest.resize(rigs.frames.size(), -1);
    num_sensor_users_.resize(rigs.sensors.size(), 0);
    for (; num_listed_images_ < problem.num_images(); ++num_listed_images_) {
        of_frame_.add(rigs.image_frame[num_listed_images_], num_listed_images_);
        if (rigs.has(num_listed_images_))
            ++num_sensor_users_[rigs.image_sensor[num_listed_images_]];
    }
}

}  // namespace clba
