// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>

#include "problem/problem.hpp"

namespace clba {

enum class SceneKind : int { hall = 1, street = 2, landmark = 3 };

struct SceneOptions {
    SceneKind kind = SceneKind::hall;
    int32_t num_images = 356;
    int32_t num_points = 0;  // 0: follows from the observations, tracks of 5 on average
    int32_t observations_per_image = 400;  // about so many on average
    uint64_t seed = 0;
    double pixel_noise = 0.5;     // standard deviation of x and of y, pixels
    double outlier_share = 0;     // of observations, moved anywhere in the image
    double rotation_noise = 0.5;  // of the start: root mean square angle, degrees
    // Root mean square displacements of the start, as shares of the mean depth of the observations.
    double position_noise = 0.01;
    double point_noise = 0.01;
};

struct Scene {
    Problem start;
    Problem truth;  // the same observations with the state that they were made from
};

// Snavely cameras of 1000 x 750 pixels, one an image; observations sorted by point, then image.
// Every point has at least two observations, every image 8 or more where its surroundings allow. On
// hall and street the start also drifts slowly along the path, as dead reckoning does, by
// position_noise of the way. Noise options change neither truth nor visibility. Equal options give
// equal scenes on every machine (up to the last bits of the mathematical library).
Scene generate_scene(const SceneOptions& options);

}  // namespace clba
