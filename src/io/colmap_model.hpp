// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "io/output_folder.hpp"
#include "io/reconstruction.hpp"

// COLMAP's sparse models as their files have them: rows that refer to each other by id.
namespace clba::colmap {

inline constexpr uint64_t no_point = UINT64_MAX;
inline constexpr const char* sensor_kinds[] = {"CAMERA", "IMU"};  // COLMAP's numbers 0, 1

struct CameraRow {
    uint32_t id = 0;
    Camera camera;
    uint64_t width = 0, height = 0;
};

struct FeatureRow {
    double x = 0, y = 0;
    uint64_t point = no_point;
};

struct ImageRow {
    uint32_t id = 0;
    uint32_t camera = 0;
    Pose pose;  // not normalised
    std::string name;
    size_t first_feature = 0, num_features = 0;
};

struct TrackElement {
    uint32_t image = 0;
    uint32_t feature = 0;
};

struct PointRow {
    PointInfo info;
    Point position{};
    size_t first_element = 0, num_elements = 0;
};

struct Model {
    std::vector<CameraRow> cameras;
    std::vector<ImageRow> images;
    std::vector<FeatureRow> features;  // image by image
    std::vector<PointRow> points;
    std::vector<TrackElement> elements;  // point by point
    bool has_frames = false;
    std::vector<Rig> rigs;
    std::vector<Frame> frames;
};

// Rows as they are, in their order; what they refer to is not looked at. Numbers are finite.
Model read_binary(const std::string& folder);
Model read_text(const std::string& folder);
void write_binary(const Model& model, OutputFolder& folder);
void write_text(const Model& model, OutputFolder& folder);

// Whether the folder has rigs and frames with this ending; an error if it has one of the two.
bool has_frame_files(const std::string& folder, const std::string& ending);

// Whether a quaternion that was read stands for a rotation.
bool can_be_normalized(const Pose& pose);

// COLMAP's number and name of a camera model, and clba's number of them. An error names the camera
// where clba has no such model; `where` begins its message.
int32_t model_id(int32_t number);
std::string model_name(int32_t number);
int32_t number_of_model_id(int32_t id, uint32_t camera, const std::string& where);
int32_t number_of_model_name(std::string_view name, uint32_t camera, const std::string& where);

}  // namespace clba::colmap
