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
    for (auto i = static_cast<int32_t>(of_image_.before.size()); i < num_observations; ++i) {
        of_image_.add(problem.observations[i].image, i);
        of_point_.add(problem.observations[i].point, i);
    }
}

}  // namespace clba
