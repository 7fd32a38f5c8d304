// SPDX-License-Identifier: Apache-2.0
#include "io/colmap_frames.hpp"

#include <algorithm>
#include <cmath>

#include "base/error.hpp"

namespace clba::colmap {
namespace {

Pose product(const Pose& a, const Pose& b) {
    const auto r = rotation_matrix(a.rotation);
    Pose made{normalized(quaternion_product(a.rotation, b.rotation)), a.translation};
    for (size_t i = 0; i < 3; ++i)
        for (size_t k = 0; k < 3; ++k) made.translation[i] += r[3 * i + k] * b.translation[k];
    return made;
}

Pose unit(const Pose& pose) {
    return {normalized(pose.rotation), pose.translation};
}

Pose inverse(const Pose& pose) {
    const auto& q = pose.rotation;
    return {{q[0], -q[1], -q[2], -q[3]}, camera_center(pose)};
}

bool agree(const Pose& a, const Pose& b) {
    constexpr double tolerance = 1e-9;
    const auto& q = b.rotation;
    const auto turn = quaternion_product(a.rotation, {q[0], -q[1], -q[2], -q[3]});
    double distance = 0, length = 0;
    for (size_t k = 0; k < 3; ++k) {
        distance = std::max(distance, std::abs(a.translation[k] - b.translation[k]));
        length = std::max(length, std::abs(a.translation[k]));
    }
    return 2 * std::hypot(turn[1], turn[2], turn[3]) <= tolerance && distance <= tolerance * length;
}

// A rig's row for a sensor, or nullptr.
const RigSensor* find(const Rig& rig, const Sensor& sensor) {
    for (const RigSensor& row : rig.sensors)
        if (row.sensor.kind == sensor.kind && row.sensor.id == sensor.id) return &row;
    return nullptr;
}

IdIndex index_of(const std::vector<Rig>& rigs) {
    return IdIndex(rigs.size(), [&](size_t i) { return rigs[i].id; });
}

void check_rigs(const std::vector<Rig>& rigs, const std::string& folder) {
    const auto is_known = [](const Sensor& sensor) {
        return sensor.kind >= 0 && sensor.kind < static_cast<int32_t>(std::size(sensor_kinds));
    };
    for (const Rig& rig : rigs)
        for (const RigSensor& row : rig.sensors) {
            if (!is_known(row.sensor))
                fail(Status::format, folder, ": rig ", rig.id, " has a sensor of the kind ",
                     row.sensor.kind, ", but the kinds are 0 (camera) and 1 (IMU)");
            if (row.has_pose && !can_be_normalized(row.sensor_from_rig))
                fail(Status::format, folder, ": sensor ", row.sensor.id, " of rig ", rig.id,
                     " has a quaternion that cannot be normalised");
        }
}

// Replaces rigs and frames by those that COLMAP makes of models without any.
void split_frames(Model& model) {
    for (const Frame& frame : model.frames)
        for (const FrameDatum& datum : frame.data)
            require(datum.sensor.kind == camera_sensor, "frame ", frame.id,
                    " has data of an IMU, and its images no longer agree with the rig, so that it "
                    "cannot be written as frames of one image each; write a format without rigs");
    model.rigs.clear();
    model.frames.clear();
    for (const CameraRow& camera : model.cameras)
        model.rigs.push_back({camera.id, {{{camera_sensor, camera.id}, true, {}}}});
    for (const ImageRow& image : model.images)
        model.frames.push_back(
            {image.id, image.camera, image.pose, {{{camera_sensor, image.camera}, image.id}}});
}

// Whether the frame's pose could be set so that all its images agree with it.
bool update(Frame& frame, const Rig& rig, const Model& model, const IdIndex& image_rows,
            std::vector<char>& is_in_frame) {
    bool has_pose = false;
    Pose pose;
    // The reference sensor's image first: its pose is the frame's, to the bit.
    for (const bool only_reference : {true, false}) {
        for (const FrameDatum& datum : frame.data) {
            const int32_t row = datum.sensor.kind == camera_sensor ? image_rows.row(datum.id) : -1;
            if (row < 0) continue;
            const ImageRow& image = model.images[row];
            const RigSensor* const sensor = find(rig, datum.sensor);
            if (!sensor || !sensor->has_pose || image.camera != datum.sensor.id) return false;
            const bool is_reference = sensor == &rig.sensors.front();
            if (is_reference != only_reference) continue;
            is_in_frame[row] = 1;
            const Pose sensor_from_rig = unit(sensor->sensor_from_rig);
            if (!has_pose)
                pose = is_reference ? image.pose : product(inverse(sensor_from_rig), image.pose);
            else if (!agree(image.pose, product(sensor_from_rig, pose)))
                return false;
            has_pose = true;
        }
    }
    if (has_pose) frame.rig_from_world = pose;
    return true;
}

}  // namespace

void take_poses_from_frames(Reconstruction& made, const IdIndex& image_rows,
                            const std::string& folder) {
    check_rigs(made.rigs, folder);
    const IdIndex rig_rows = index_of(made.rigs);
    if (rig_rows.duplicate())
        fail(Status::format, folder, " has two rigs of the id ", *rig_rows.duplicate());
    if (const IdIndex frames(made.frames.size(), [&](size_t i) { return made.frames[i].id; });
        frames.duplicate())
        fail(Status::format, folder, " has two frames of the id ", *frames.duplicate());
    std::vector<char> is_in_frame(made.images.size());
    int64_t num_frames = 0, num_images = 0;  // of frames of several images
    for (const Frame& frame : made.frames) {
        const auto fail_here = [&](const auto&... parts) {
            fail(Status::format, folder, ": frame ", frame.id, " ", parts...);
        };
        const int32_t rig_row = rig_rows.row(frame.rig);
        if (rig_row < 0) fail_here("refers to rig ", frame.rig, ", but there is no such rig");
        if (!can_be_normalized(frame.rig_from_world))
            fail_here("has a quaternion that cannot be normalised");
        int64_t num_in_frame = 0;
        for (const FrameDatum& datum : frame.data) {
            const RigSensor* const sensor = find(made.rigs[rig_row], datum.sensor);
            if (!sensor)
                fail_here("has data of sensor ", datum.sensor.id, ", which rig ", frame.rig,
                          " does not have");
            const int32_t row = datum.sensor.kind == camera_sensor ? image_rows.row(datum.id) : -1;
            if (row < 0) continue;  // an image that is not registered, or no image
            const uint64_t camera = made.cameras[made.problem.images[row].camera].id;
            if (camera != datum.sensor.id)
                fail_here("has image ", datum.id, " as one of camera ", datum.sensor.id,
                          ", but it is of camera ", camera);
            if (std::exchange(is_in_frame[row], char{1}))
                fail_here("has image ", datum.id, ", which a frame has already");
            ++num_in_frame;
            Pose& pose = made.problem.images[row].pose;
            if (sensor == &made.rigs[rig_row].sensors.front())
                pose = unit(frame.rig_from_world);
            else if (sensor->has_pose)
                pose = product(unit(sensor->sensor_from_rig), unit(frame.rig_from_world));
            const auto& t = pose.translation;
            if (!std::isfinite(t[0] + t[1] + t[2]))
                fail_here("and its rig give image ", datum.id, " a translation that is not finite");
        }
        num_frames += num_in_frame > 1;
        num_images += num_in_frame > 1 ? num_in_frame : 0;
    }
    for (size_t i = 0; i < is_in_frame.size(); ++i)
        if (!is_in_frame[i])
            fail(Status::format, folder, ": image ", made.images[i].id, " is in no frame");
    if (num_frames > 0)
        made.notices.push_back(
            text(num_images, " images are parts of ", num_frames,
                 " frames of several sensors. clba solves them as free images; once they no longer "
                 "agree with their rigs, a COLMAP model is written with a frame for each image and "
                 "a rig for each camera."));
}

void update_frames(Model& model) {
    const IdIndex rig_rows = index_of(model.rigs);
    const IdIndex image_rows(model.images.size(), [&](size_t i) { return model.images[i].id; });
    std::vector<char> is_in_frame(model.images.size());
    const bool agrees = std::all_of(model.frames.begin(), model.frames.end(), [&](Frame& frame) {
        return update(frame, model.rigs[rig_rows.row(frame.rig)], model, image_rows, is_in_frame);
    });
    if (!agrees || std::find(is_in_frame.begin(), is_in_frame.end(), 0) != is_in_frame.end())
        split_frames(model);
}

}  // namespace clba::colmap
