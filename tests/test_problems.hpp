// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"
#include "reference/bundle.hpp"

// Small problems that the tests share. Equal arguments give equal problems.
namespace clba::test {

std::vector<int32_t> all_camera_models();

// Cameras around the origin at distance 5 look at points within a ball of radius 1; every image
// sees a random 60 % of the points, and every point has two observations or more if there are two
// images. Observations have a noise of 0.5 pixels, are in random order, and belong to a state about
// 0.01 away from the one returned. models are cycled over the cameras: one camera an image, or, if
// shared_cameras, as many as there are models but at least two images for each.
Problem small_scene(int num_images, int num_points, const std::vector<int32_t>& models,
                    bool shared_cameras, uint64_t seed);
// Two models, and joint and split blocks: images 0 (snavely) and 1 (opencv) own their cameras, the
// others, at least two, share one (snavely).
Problem mixed_scene(int num_images, int num_points, uint64_t seed);

// The same ball, seen by a rig of three sensors: image 3 f + s is of frame f and sensor s, of which
// sensor 0 is constant at the rig's origin. Each sensor has an opencv camera, but image
// 2 has one of its own. Then follow an image of sensor 1 and one of sensor 0, alone in their
// frames, and two of no rig, of which the first has a snavely camera to itself.
Problem rig_scene(int num_frames, int num_points, uint64_t seed);

// One image of each model, and of fov with awkward values of omega, at the origin: points in the
// middle (0 and 1e-9 off), up to 80 degrees away from it, and behind.
Problem wide_angle_scene();

// Two cameras of each model, one of an image alone and one that two images share, see a shell of
// points around them up to 60 degrees from their axes, without noise.
struct Recoverable {
    Problem truth, start;
};
Recoverable recoverable_scene();

// With an unused camera of the model with most parameters, so that problems of different models
// share kernels.
Problem with_widest_camera(Problem problem);
Problem with_covariances(Problem problem, uint64_t seed);
Problem with_loss(Problem problem, LossKind kind, double scale);
// Holds the pose of image 0, the rotation of image 1, the position of image 2, the first parameter
// of camera 0, all parameters of the last camera and every fifth point, as far as they exist.
Problem with_constants(Problem problem);
Problem with_uncertainties(Problem problem, uint64_t seed);  // between 0.1 and 10
// All kinds of priors, of covariances with cross terms, and targets that the state is some sigmas
// away from: positions of even images, the poses of images 1 and 2, intrinsics of the first and the
// last camera but for their second parameter, every fourth point from point 1, and relative poses
// of images 0 and 3 (two), 4 and 1, and the last and the first, as far as they exist.
Problem with_priors(Problem problem, uint64_t seed);

// The same problem in a world moved by offset (along each axis) or enlarged by factor.
Problem shifted(Problem problem, double offset);
Problem scaled(Problem problem, double factor);

// Everything that real files do wrong: image 0 has the rotation 0; point 10 is behind it, point 11
// at its centre, point 12 in its plane; point 13 is seen once and point 14 not at all; image 1 sees
// point 0 twice; image 4 sees nothing and no image uses camera 4. Images 1 and 2 share camera 1.
Problem planted_trouble();
inline constexpr int64_t planted_num_behind = 1;
inline constexpr int64_t planted_num_singular = 2;

std::vector<double> random_vector(int64_t size, uint64_t seed);  // uniform in [-1, 1]

// Dense matrix of the stored blocks, columns in the order of the layout.
Eigen::MatrixXd dense(const Problem& problem, const ParameterLayout& layout,
                      const reference::Jacobian& jacobian);

// f'(0) by the central difference of fourth order, whose error is step^4 f^(5) / 30.
template <class Function>
auto central_difference(const Function& f, double step) {
    return ((8.0 * (f(step) - f(-step)) - (f(2 * step) - f(-2 * step))) / (12 * step)).eval();
}

}  // namespace clba::test
