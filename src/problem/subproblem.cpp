// SPDX-License-Identifier: Apache-2.0
#include "problem/subproblem.hpp"

#include <algorithm>
#include <limits>

#include "base/error.hpp"

namespace clba {
namespace {

constexpr uint32_t all_params = std::numeric_limits<uint32_t>::max();
constexpr uint8_t all_of_pose = constant_rotation | constant_position;

void make_unique(std::vector<int32_t>& rows) {
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
}

bool contains(const std::vector<int32_t>& ascending, int32_t row) {
    return std::binary_search(ascending.begin(), ascending.end(), row);
}

int32_t place_of(const std::vector<int32_t>& ascending, int32_t row) {
    return static_cast<int32_t>(std::lower_bound(ascending.begin(), ascending.end(), row) -
                                ascending.begin());
}

// The caller's list, ascending.
std::vector<int32_t> checked(const std::vector<int32_t>& rows, int32_t num_rows, const char* name) {
    for (size_t i = 0; i < rows.size(); ++i)
        require(rows[i] >= 0 && rows[i] < num_rows, "window.", name, "[", i, "] = ", rows[i],
                ", but num_", name, " = ", num_rows);
    std::vector<int32_t> ascending = rows;
    std::sort(ascending.begin(), ascending.end());
    const auto twice = std::adjacent_find(ascending.begin(), ascending.end());
    require(twice == ascending.end(), "window.", name, " has ",
            twice == ascending.end() ? 0 : *twice, " twice, but each may occur once");
    return ascending;
}

// The rows of an optional array, or of one that is not.
template <class Row>
std::vector<Row> selected(const std::vector<Row>& all, const std::vector<int32_t>& rows) {
    std::vector<Row> some;
    if (all.empty()) return some;
    some.reserve(rows.size());
    for (const int32_t row : rows) some.push_back(all[row]);
    return some;
}

// Flags of an optional array, which is filled with zeros if it is empty.
template <class Flag>
std::vector<Flag>& all_flags(std::vector<Flag>& flags, size_t num_rows) {
    flags.resize(num_rows, 0);
    return flags;
}

// Of rows that were selected, under their new number.
template <class Prior>
std::vector<Prior> selected_priors(const std::vector<Prior>& priors, int32_t Prior::*row,
                                   const std::vector<int32_t>& rows) {
    std::vector<Prior> some;
    for (const Prior& prior : priors) {
        if (!contains(rows, prior.*row)) continue;
        some.push_back(prior);
        some.back().*row = place_of(rows, prior.*row);
    }
    return some;
}

// Those that all of their rows were selected of.
Priors selected_priors(const Priors& priors, const RowSelection& rows) {
    Priors some;
    some.positions = selected_priors(priors.positions, &PositionPrior::image, rows.images);
    some.poses = selected_priors(priors.poses, &PosePrior::image, rows.images);
    some.intrinsics = selected_priors(priors.intrinsics, &IntrinsicsPrior::camera, rows.cameras);
    some.points = selected_priors(priors.points, &PointPrior::point, rows.points);
    some.relative_poses = selected_priors(
        selected_priors(priors.relative_poses, &RelativePosePrior::first, rows.images),
        &RelativePosePrior::second, rows.images);
    return some;
}

// Frames and sensors that images were selected of.
Rigs selected_rigs(const Rigs& rigs, const std::vector<int32_t>& frames,
                   const std::vector<int32_t>& sensors, const std::vector<int32_t>& images) {
    Rigs some;
    if (frames.empty()) return some;
    some.frames = selected(rigs.frames, frames);
    some.sensors = selected(rigs.sensors, sensors);
    some.constant_frames = selected(rigs.constant_frames, frames);
    some.constant_sensors = selected(rigs.constant_sensors, sensors);
    for (const int32_t image : images) {
        const bool has_rig = rigs.has(image);
        some.image_frame.push_back(has_rig ? place_of(frames, rigs.image_frame[image]) : -1);
        some.image_sensor.push_back(has_rig ? place_of(sensors, rigs.image_sensor[image]) : -1);
    }
    return some;
}

// With the other images of their frames, ascending.
std::vector<int32_t> with_their_frames(const Rigs& rigs, const ObservationIndex& index,
                                       std::vector<int32_t> images) {
    if (rigs.empty()) return images;
    const size_t num_named = images.size();
    for (size_t k = 0; k < num_named; ++k)
        if (rigs.has(images[k]))
            index.for_each_of_frame(rigs.image_frame[images[k]],
                                    [&](int32_t i) { images.push_back(i); });
    make_unique(images);
    return images;
}

// Holds the sensors that no image of the window uses or, unless they are to be refined, others use
// too. `part`: the rigs of images `rows`.
void hold_shared_sensors(const Rigs& rigs, const ObservationIndex& index,
                         const std::vector<int32_t>& window, const std::vector<int32_t>& rows,
                         bool refines_shared, Rigs& part) {
    std::vector<int32_t> num_users(part.sensors.size(), 0), row_of(part.sensors.size(), -1);
    for (size_t i = 0; i < part.image_sensor.size(); ++i) {
        const int32_t sensor = part.image_sensor[i];
        if (sensor < 0) continue;
        row_of[sensor] = rigs.image_sensor[rows[i]];
        num_users[sensor] += contains(window, rows[i]);
    }
    for (size_t s = 0; s < num_users.size(); ++s) {
        const bool is_shared = num_users[s] < index.num_sensor_users(row_of[s]);
        if (num_users[s] == 0 || (is_shared && !refines_shared))
            part.constant_sensors[s] = all_of_pose;
    }
}

// What images have in rigs, ascending; rows: of each image, -1: none.
std::vector<int32_t> rows_of_rigs(const std::vector<int32_t>& rows,
                                  const std::vector<int32_t>& images) {
    std::vector<int32_t> some;
    if (rows.empty()) return some;
    for (const int32_t image : images)
        if (rows[image] >= 0) some.push_back(rows[image]);
    make_unique(some);
    return some;
}

}  // namespace

Problem select_rows(const Problem& problem, const RowSelection& rows) {
    Problem part;
    part.cameras = selected(problem.cameras, rows.cameras);
    part.images = selected(problem.images, rows.images);
    part.points = selected(problem.points, rows.points);
    part.observations = selected(problem.observations, rows.observations);
    part.whitening = selected(problem.whitening, rows.observations);
    part.constant_images = selected(problem.constant_images, rows.images);
    part.constant_cameras = selected(problem.constant_cameras, rows.cameras);
    part.constant_points = selected(problem.constant_points, rows.points);
    part.image_uncertainties = selected(problem.image_uncertainties, rows.images);
    part.camera_uncertainties = selected(problem.camera_uncertainties, rows.cameras);
    part.point_uncertainties = selected(problem.point_uncertainties, rows.points);
    part.loss = problem.loss;
    part.priors = selected_priors(problem.priors, rows);
    part.rigs = selected_rigs(problem.rigs, rows_of_rigs(problem.rigs.image_frame, rows.images),
                              rows_of_rigs(problem.rigs.image_sensor, rows.images), rows.images);
    for (Image& image : part.images) image.camera = place_of(rows.cameras, image.camera);
    for (Observation& observation : part.observations) {
        observation.image = place_of(rows.images, observation.image);
        observation.point = place_of(rows.points, observation.point);
    }
    return part;
}

Subproblem extract(const Problem& problem, const ObservationIndex& index, const Window& window) {
    const std::vector<int32_t> images = with_their_frames(
        problem.rigs, index, checked(window.images, problem.num_images(), "images"));
    std::vector<int32_t> seen;  // by these
    Subproblem part;
    RowSelection& rows = part.rows;
    for (const int32_t image : images) {
        index.for_each_of_image(image, [&](int32_t i) {
            seen.push_back(problem.observations[i].point);
            rows.observations.push_back(i);
        });
    }
    make_unique(seen);
    const std::vector<int32_t> points =
        window.all_points ? seen : checked(window.points, problem.num_points(), "points");
    for (const int32_t point : points)
        index.for_each_of_point(point, [&](int32_t i) { rows.observations.push_back(i); });
    make_unique(rows.observations);

    rows.points = seen;
    rows.points.insert(rows.points.end(), points.begin(), points.end());
    make_unique(rows.points);
    rows.images = images;
    for (const int32_t i : rows.observations) rows.images.push_back(problem.observations[i].image);
    make_unique(rows.images);
    for (const int32_t image : rows.images) rows.cameras.push_back(problem.images[image].camera);
    make_unique(rows.cameras);

    part.problem = select_rows(problem, rows);
    std::vector<int32_t> num_users(rows.cameras.size(), 0);  // in the window
    for (const int32_t image : images)
        ++num_users[place_of(rows.cameras, problem.images[image].camera)];
    std::vector<uint8_t>& constant_images =
        all_flags(part.problem.constant_images, rows.images.size());
    for (size_t i = 0; i < rows.images.size(); ++i) {
        if (contains(images, rows.images[i])) continue;
        ++part.num_constant_images;
        if (part.problem.rigs.has(static_cast<int32_t>(i)))
            part.problem.rigs.constant_frames[part.problem.rigs.image_frame[i]] = all_of_pose;
        else
            constant_images[i] = all_of_pose;
    }
    hold_shared_sensors(problem.rigs, index, images, rows.images, window.refine_shared_cameras,
                        part.problem.rigs);
    std::vector<uint32_t>& constant_cameras =
        all_flags(part.problem.constant_cameras, rows.cameras.size());
    for (size_t c = 0; c < rows.cameras.size(); ++c) {
        const bool is_shared = num_users[c] < index.num_users(rows.cameras[c]);
        if (num_users[c] == 0 || (is_shared && !window.refine_shared_cameras))
            constant_cameras[c] = all_params;
    }
    if (rows.points.size() > points.size()) {
        std::vector<uint8_t>& constant_points =
            all_flags(part.problem.constant_points, rows.points.size());
        for (size_t p = 0; p < rows.points.size(); ++p)
            if (!contains(points, rows.points[p])) constant_points[p] = 1;
    }
    for (size_t p = 0; p < rows.points.size(); ++p)
        part.num_free_points +=
            part.problem.constant_points.empty() || !part.problem.constant_points[p];
    return part;
}

void write_state_back(const Subproblem& from, Problem& problem) {
    const RowSelection& rows = from.rows;
    for (size_t c = 0; c < rows.cameras.size(); ++c)
        problem.cameras[rows.cameras[c]].params = from.problem.cameras[c].params;
    for (size_t i = 0; i < rows.images.size(); ++i)
        problem.images[rows.images[i]].pose = from.problem.images[i].pose;
    // Images outside of the window move with their sensors.
    const Rigs& part = from.problem.rigs;
    bool has_moved = false;
    for (size_t i = 0; i < part.image_frame.size(); ++i) {
        if (part.image_frame[i] < 0) continue;
        Rigs& rigs = problem.rigs;
        rigs.frames[rigs.image_frame[rows.images[i]]] = part.frames[part.image_frame[i]];
        Pose& sensor = rigs.sensors[rigs.image_sensor[rows.images[i]]];
        const Pose& moved = part.sensors[part.image_sensor[i]];
        has_moved = has_moved || sensor.rotation != moved.rotation ||
                    sensor.translation != moved.translation;
        sensor = moved;
    }
    if (has_moved) compose_images(problem.rigs, problem.images);
    for (size_t p = 0; p < rows.points.size(); ++p)
        problem.points[rows.points[p]] = from.problem.points[p];
}

}  // namespace clba
