// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "problem/problem.hpp"
#include "problem/removal.hpp"

namespace clba {

struct CameraInfo {
    uint64_t id = 0;
    uint64_t width = 0, height = 0;  // pixels; 0: unknown
};

struct ImageInfo {
    uint64_t id = 0;
    std::string name;
};

struct PointInfo {
    uint64_t id = 0;
    std::array<uint8_t, 3> color{255, 255, 255};
    double error = 0;  // as it was read: mean reprojection error in pixels
};

// An image's feature that no point claims.
struct Feature {
    int32_t image = 0;
    int32_t index = 0;    // among all features of its image
    double x = 0, y = 0;  // pixels
};

// COLMAP's number of the kind of a sensor, and which one: camera_sensor and a CameraInfo's id, or
// something else that is kept and written back.
struct Sensor {
    int32_t kind = 0;
    uint32_t id = 0;
};
inline constexpr int32_t camera_sensor = 0;

struct RigSensor {
    Sensor sensor;
    bool has_pose = true;
    Pose sensor_from_rig;  // as it was read; of the reference sensor the identity
};

struct Rig {
    uint64_t id = 0;
    std::vector<RigSensor> sensors;  // the reference sensor first
};

// What the sensors of a rig took at one moment.
struct FrameDatum {
    Sensor sensor;
    uint64_t id = 0;  // of a camera: an ImageInfo's id
};
struct Frame {
    uint64_t id = 0;
    uint64_t rig = 0;     // its id
    Pose rig_from_world;  // as it was read
    std::vector<FrameDatum> data;
};

// What a file held that has no place in a Reconstruction, and its numbers before they were
// converted. The writer of the same format uses it where it still fits the problem; others do not
// know it.
struct SourceDetails {
    explicit SourceDetails(const char* its_format, bool is_content = true)
        : format(its_format), has_content(is_content) {}
    virtual ~SourceDetails() = default;
    const char* format;  // its name
    bool has_content;    // that other formats lose; false: the last bits of numbers only
};

// What reconstruction files hold: a problem, and what a solver has no use for but a file written
// back must keep. Each vector is empty or has one row a camera, image, point or observation.
struct Reconstruction {
    Problem problem;
    std::vector<CameraInfo> cameras;
    std::vector<ImageInfo> images;
    std::vector<PointInfo> points;
    std::vector<int32_t> observation_features;     // index of the feature among those of its image
    std::vector<Feature> unmatched;                // any number, by image, then index
    bool has_frames = false;                       // the file has rigs and frames, even if none
    std::vector<Rig> rigs;                         // any number
    std::vector<Frame> frames;                     // any number
    std::vector<Pose> poses_read;                  // of images; quaternions need not have length 1
    uint64_t digest_read = 0;                      // digest() when it was read; 0: never
    std::vector<std::string> notices;              // what the problem cannot hold, for people
    std::shared_ptr<const SourceDetails> details;  // may be null
};

// Of cameras, images, points and rigs: what was read with them and follows from them (errors of
// points, quaternions before they were normalised, poses of frames) is written as it was while this
// is.
uint64_t digest(const Problem& problem);

// As problem/removal.hpp has it, with what is known of the rows: the features of removed
// observations become unmatched ones.
RowMaps remove_observations(Reconstruction& reconstruction, const std::vector<uint8_t>& goes,
                            bool removes_points);

// Describes rows that were appended to the problem: ids go on from the largest. Features are
// counted anew when the reconstruction is written, and with new images each is a frame of its own.
void extend_infos(Reconstruction& reconstruction);

// Drops what no longer has as many rows as the problem.
void drop_mismatched(Reconstruction& reconstruction);

}  // namespace clba
