// SPDX-License-Identifier: Apache-2.0
#include "io/colmap_frames.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>

#include "base/error.hpp"

namespace clba::colmap {
namespace {

Pose unit(const Pose& pose) {
    return {normalized(pose.rotation), pose.translation};
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
template <class RigOrConst>
auto find(RigOrConst& rig, const Sensor& sensor) -> decltype(rig.sensors.data()) {
    for (auto& row : rig.sensors)
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

// For frames to be replaced.
void require_images_alone(const Model& model) {
    for (const Frame& frame : model.frames)
        for (const FrameDatum& datum : frame.data)
            require(datum.sensor.kind == camera_sensor, "frame ", frame.id,
                    " has data of an IMU, and its images no longer agree with the rig, so that it "
                    "cannot be replaced by other frames; write a format without rigs");
}

// Replaces rigs and frames by those that COLMAP makes of models without any.
void split_frames(Model& model) {
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

// The rigs of a problem whose images come in the order of frames.
class ProblemRigs {
public:
    explicit ProblemRigs(int32_t num_images) {
        rigs_.image_frame.assign(static_cast<size_t>(num_images), -1);
        rigs_.image_sensor.assign(static_cast<size_t>(num_images), -1);
    }

    // The image's pose.
    Pose add(int32_t image, const Rig& rig, const RigSensor& sensor, const Frame& frame) {
        if (frame_ != &frame) {
            frame_ = &frame;
            rigs_.frames.push_back(unit(frame.rig_from_world));
        }
        const auto [row, is_new] =
            sensor_rows_.try_emplace(&sensor, static_cast<int32_t>(rigs_.sensors.size()));
        if (is_new) {
            const bool is_reference = &sensor == &rig.sensors.front();
            rigs_.sensors.push_back(is_reference ? Pose() : unit(sensor.sensor_from_rig));
            rigs_.constant_sensors.push_back(is_reference ? constant_rotation | constant_position
                                                          : 0);
        }
        rigs_.image_frame[image] = static_cast<int32_t>(rigs_.frames.size()) - 1;
        rigs_.image_sensor[image] = row->second;
        return composed_pose(rigs_, image);
    }

    // Nothing where no image needs more than a pose of its own.
    Rigs take() {
        rigs_.constant_frames.assign(rigs_.frames.size(), 0);
        return composed_images(rigs_).empty() ? Rigs() : std::move(rigs_);
    }

private:
    Rigs rigs_;
    const Frame* frame_ = nullptr;
    std::map<const RigSensor*, int32_t> sensor_rows_;
};

// Whether the model's rigs are the problem's, row by row; then its sensors get the problem's poses.
bool update_sensors(Model& model, const IdIndex& rig_rows, const IdIndex& image_rows,
                    const Rigs& rigs) {
    std::vector<RigSensor*> sensor_of(rigs.sensors.size(), nullptr);
    std::vector<const Frame*> frame_of(rigs.frames.size(), nullptr);
    for (const Frame& frame : model.frames) {
        Rig& rig = model.rigs[rig_rows.row(frame.rig)];
        int32_t frame_row = -1;
        for (const FrameDatum& datum : frame.data) {
            const int32_t image =
                datum.sensor.kind == camera_sensor ? image_rows.row(datum.id) : -1;
            if (image < 0) continue;
            if (!rigs.has(image)) return false;
            if (frame_row >= 0 && frame_row != rigs.image_frame[image]) return false;
            frame_row = rigs.image_frame[image];
            const Frame*& known_frame = frame_of[frame_row];
            if (known_frame && known_frame != &frame) return false;
            known_frame = &frame;
            RigSensor* const sensor = find(rig, datum.sensor);
            RigSensor*& known = sensor_of[rigs.image_sensor[image]];
            if (!sensor || (known && known != sensor)) return false;
            known = sensor;
            const Pose& pose = rigs.sensors[rigs.image_sensor[image]];
            const bool is_origin = pose.rotation[0] == 1 && pose.translation == Point{0, 0, 0};
            if (sensor == &rig.sensors.front() && !is_origin) return false;
        }
    }
    for (size_t s = 0; s < sensor_of.size(); ++s)
        for (size_t other = 0; other < s; ++other)
            if (sensor_of[s] && sensor_of[s] == sensor_of[other]) return false;
    for (size_t s = 0; s < sensor_of.size(); ++s) {
        if (!sensor_of[s]) continue;
        sensor_of[s]->has_pose = true;
        sensor_of[s]->sensor_from_rig = rigs.sensors[s];
    }
    return true;
}

// Which rig each sensor is of, by the frames that they share, and the rig's reference sensor: the
// first at its origin, or else the first.
struct SensorGroups {
    explicit SensorGroups(const Rigs& rigs) : reference(rigs.sensors.size()) {
        std::iota(reference.begin(), reference.end(), 0);
        std::vector<int32_t> of_frame(rigs.frames.size(), -1);
        for (size_t i = 0; i < rigs.image_frame.size(); ++i) {
            if (rigs.image_frame[i] < 0) continue;
            int32_t& sensor = of_frame[rigs.image_frame[i]];
            if (sensor >= 0) join(root(sensor), root(rigs.image_sensor[i]));
            sensor = rigs.image_sensor[i];
        }
        std::vector<int32_t> first(reference.size(), -1);
        for (int32_t s = 0; s < static_cast<int32_t>(reference.size()); ++s) {
            const Pose& pose = rigs.sensors[s];
            const bool is_origin = pose.rotation[0] == 1 && pose.translation == Point{0, 0, 0};
            if (is_origin && first[root(s)] < 0) first[root(s)] = s;
        }
        std::vector<int32_t> found(reference.size());
        for (int32_t s = 0; s < static_cast<int32_t>(reference.size()); ++s)
            found[s] = first[root(s)] < 0 ? root(s) : first[root(s)];
        reference = std::move(found);
    }
    std::vector<int32_t> reference;  // of each sensor's rig

private:
    int32_t root(int32_t sensor) const {
        while (reference[sensor] != sensor) sensor = reference[sensor];
        return sensor;
    }
    void join(int32_t a, int32_t b) { reference[std::max(a, b)] = std::min(a, b); }
};

// The camera of each sensor, by its row; nothing where a sensor has several, or shares one with
// another sensor or with an image of no rig.
std::optional<std::vector<int32_t>> cameras_of_sensors(const Problem& problem) {
    const Rigs& rigs = problem.rigs;
    std::vector<int32_t> camera_of(rigs.sensors.size(), -1), sensor_of(problem.cameras.size(), -2);
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int32_t camera = problem.images[i].camera;
        const int32_t sensor = rigs.has(i) ? rigs.image_sensor[i] : -1;
        if (sensor_of[camera] != -2 && sensor_of[camera] != sensor) return std::nullopt;
        sensor_of[camera] = sensor;
        if (sensor < 0) continue;
        if (camera_of[sensor] >= 0 && camera_of[sensor] != camera) return std::nullopt;
        camera_of[sensor] = camera;
    }
    return camera_of;
}

// Makes rigs and frames of a problem's, with a rig for the camera of images that are in none.
void make_frames(Model& model, const Problem& problem, const std::vector<int32_t>& camera_of) {
    const Rigs& rigs = problem.rigs;
    const SensorGroups groups(rigs);
    model.rigs.clear();
    model.frames.clear();
    std::vector<std::optional<uint64_t>> rig_of_camera(model.cameras.size());
    const auto sensor_id = [&](int32_t camera) {
        return Sensor{camera_sensor, model.cameras[camera].id};
    };
    for (size_t s = 0; s < camera_of.size(); ++s) {
        const auto reference = static_cast<size_t>(groups.reference[s]);
        if (camera_of[s] < 0 || reference != s) continue;
        Rig rig{model.cameras[camera_of[s]].id, {{sensor_id(camera_of[s]), true, {}}}};
        rig_of_camera[camera_of[s]] = rig.id;
        for (size_t other = 0; other < camera_of.size(); ++other) {
            if (other == s || camera_of[other] < 0 ||
                groups.reference[other] != groups.reference[s])
                continue;
            rig.sensors.push_back({sensor_id(camera_of[other]), true,
                                   product(rigs.sensors[other], inverse(rigs.sensors[s]))});
            rig_of_camera[camera_of[other]] = rig.id;
        }
        model.rigs.push_back(std::move(rig));
    }
    for (size_t c = 0; c < model.cameras.size(); ++c) {
        if (rig_of_camera[c]) continue;
        rig_of_camera[c] = model.cameras[c].id;
        model.rigs.push_back(
            {model.cameras[c].id, {{sensor_id(static_cast<int32_t>(c)), true, {}}}});
    }
    std::vector<int32_t> row_of(rigs.frames.size(), -1);
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int32_t camera = problem.images[i].camera;
        int32_t row = static_cast<int32_t>(model.frames.size());
        if (rigs.has(i) && row_of[rigs.image_frame[i]] >= 0) {
            row = row_of[rigs.image_frame[i]];
        } else {
            Pose pose = problem.images[i].pose;
            if (rigs.has(i)) {
                row_of[rigs.image_frame[i]] = row;
                pose = product(rigs.sensors[groups.reference[rigs.image_sensor[i]]],
                               rigs.frames[rigs.image_frame[i]]);
            }
            model.frames.push_back({model.images[i].id, *rig_of_camera[camera], pose, {}});
        }
        model.frames[row].data.push_back({sensor_id(camera), model.images[i].id});
    }
}

}  // namespace

bool can_hold_rigs(const Problem& problem) {
    return problem.rigs.empty() || cameras_of_sensors(problem).has_value();
}

void take_poses_from_frames(Reconstruction& made, const IdIndex& image_rows,
                            const std::string& folder) {
    check_rigs(made.rigs, folder);
    ProblemRigs rigs(made.problem.num_images());
    const IdIndex rig_rows = index_of(made.rigs);
    if (rig_rows.duplicate())
        fail(Status::format, folder, " has two rigs of the id ", *rig_rows.duplicate());
    if (const IdIndex frames(made.frames.size(), [&](size_t i) { return made.frames[i].id; });
        frames.duplicate())
        fail(Status::format, folder, " has two frames of the id ", *frames.duplicate());
    std::vector<char> is_in_frame(made.images.size());
    int64_t num_free = 0;  // images of sensors without a pose
    for (const Frame& frame : made.frames) {
        const auto fail_here = [&](const auto&... parts) {
            fail(Status::format, folder, ": frame ", frame.id, " ", parts...);
        };
        const int32_t rig_row = rig_rows.row(frame.rig);
        if (rig_row < 0) fail_here("refers to rig ", frame.rig, ", but there is no such rig");
        if (!can_be_normalized(frame.rig_from_world))
            fail_here("has a quaternion that cannot be normalised");
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
            Pose& pose = made.problem.images[row].pose;
            if (sensor == &made.rigs[rig_row].sensors.front() || sensor->has_pose)
                pose = rigs.add(row, made.rigs[rig_row], *sensor, frame);
            else
                ++num_free;
            const auto& t = pose.translation;
            if (!std::isfinite(t[0] + t[1] + t[2]))
                fail_here("and its rig give image ", datum.id, " a translation that is not finite");
        }
    }
    for (size_t i = 0; i < is_in_frame.size(); ++i)
        if (!is_in_frame[i])
            fail(Status::format, folder, ": image ", made.images[i].id, " is in no frame");
    made.problem.rigs = rigs.take();
    if (num_free > 0)
        made.notices.push_back(
            text(num_free,
                 " images are of sensors whose pose in their rig is not known. clba "
                 "solves them as free images of no rig; a COLMAP model is then written "
                 "with a frame for each image and a rig for each camera."));
}

void update_frames(const Problem& problem, Model& model) {
    const IdIndex rig_rows = index_of(model.rigs);
    const IdIndex image_rows(model.images.size(), [&](size_t i) { return model.images[i].id; });
    std::vector<char> is_in_frame(model.images.size());
    const bool agrees =
        (problem.rigs.empty() || update_sensors(model, rig_rows, image_rows, problem.rigs)) &&
        std::all_of(model.frames.begin(), model.frames.end(),
                    [&](Frame& frame) {
                        return update(frame, model.rigs[rig_rows.row(frame.rig)], model, image_rows,
                                      is_in_frame);
                    }) &&
        std::find(is_in_frame.begin(), is_in_frame.end(), 0) == is_in_frame.end();
    if (agrees) return;
    require_images_alone(model);
    const auto camera_of = cameras_of_sensors(problem);
    if (problem.rigs.empty() || !camera_of)
        split_frames(model);
    else
        make_frames(model, problem, *camera_of);
    model.has_frames = true;
}

}  // namespace clba::colmap
