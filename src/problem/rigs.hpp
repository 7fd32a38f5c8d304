// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "problem/pose.hpp"

namespace clba {

struct Image;
struct Problem;

// Sensors that are fixed to one body: an image of frame f and sensor s has the pose
// camera_from_world = sensor_from_rig(s) rig_from_world(f), R = R_s R_f and t = R_s t_f + t_s.
// Whoever moves a frame or a sensor calls compose_images().
struct Rigs {
    std::vector<int32_t> image_frame;       // of each image, -1: it is in no rig
    std::vector<int32_t> image_sensor;      // likewise
    std::vector<Pose> frames;               // rig_from_world; each has an image
    std::vector<Pose> sensors;              // sensor_from_rig
    std::vector<uint8_t> constant_frames;   // ConstantPose bits, one a frame
    std::vector<uint8_t> constant_sensors;  // one a sensor

    bool empty() const { return frames.empty(); }
    bool has(int32_t image) const { return !frames.empty() && image_frame[image] >= 0; }
};

// Throws where a rule is broken: images that exist, in frames and of sensors that exist or in no
// rig, poses finite with unit quaternions, each frame with an image, and neither constants nor
// uncertainties of images that are in a rig.
void require_valid(const Rigs& rigs, const Problem& problem);

// The pose that an image of a rig has by its frame and its sensor.
Pose composed_pose(const Rigs& rigs, int32_t image);

// The images whose pose depends on more than one of their own, by frame: all of rigs but those that
// are alone in their frame and of a constant sensor that is the rig's origin, whose pose is that of
// their frame.
std::vector<int32_t> composed_images(const Rigs& rigs);

// The frames' poses from those of their images, of which those of constant sensors at the rig's
// origin come first. Throws where an image does not agree with its frame and its sensor.
std::vector<Pose> frames_from_images(const Rigs& rigs, const std::vector<Image>& images);

// Gives frames the poses of their images where these are not composed.
void take_frames_of_images(const std::vector<int32_t>& composed, Problem& problem);

// Sets the poses of images by those of their frames and sensors.
void compose_images(const Rigs& rigs, std::vector<Image>& images);

// The derivative A of an image's tangent by that of its frame, row-major 6x6 in the tangent space
// of clba.h, which depends on the sensor alone:
//   w_i = R_s w,  v_i = R_s v + [t_s]_x R_s w.
// That by its sensor's is I.
std::array<double, 36> frame_tangent(const Pose& sensor);

}  // namespace clba
