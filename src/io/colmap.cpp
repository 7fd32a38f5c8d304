// SPDX-License-Identifier: Apache-2.0
#include "io/colmap.hpp"

#include <algorithm>
#include <filesystem>
#include <limits>
#include <optional>

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "io/colmap_frames.hpp"
#include "io/colmap_model.hpp"
#include "io/convert.hpp"
#include "io/id_index.hpp"
#include "problem/counting_sort.hpp"
#include "reference/bundle.hpp"

namespace clba {
namespace {

using colmap::FeatureRow;
using colmap::ImageRow;
using colmap::Model;
using colmap::no_point;
using colmap::PointRow;
using colmap::TrackElement;

constexpr auto most_rows = static_cast<size_t>(std::numeric_limits<int32_t>::max());

Pose normalized_pose(const Pose& pose, const std::string& folder, const char* row, uint64_t id) {
    if (!colmap::can_be_normalized(pose))
        fail(Status::format, folder, ": the quaternion of ", row, " ", id, " is (",
             pose.rotation[0], ", ", pose.rotation[1], ", ", pose.rotation[2], ", ",
             pose.rotation[3], "), but it must be one that can be normalised");
    return {normalized(pose.rotation), pose.translation};
}

void require_rows(size_t count, const char* rows, const std::string& folder) {
    if (count > most_rows)
        fail(Status::format, folder, " has ", count, " ", rows, ", but clba takes no more than ",
             most_rows);
}

// The features that a model's tracks name become observations. Every feature that names a point
// must be in that point's track.
void add_observations(const Model& model, const IdIndex& image_rows, const std::string& folder,
                      Reconstruction& made) {
    std::vector<Observation>& observations = made.problem.observations;
    observations.resize(model.elements.size());
    made.observation_features.resize(model.elements.size());
    std::vector<size_t> features(model.elements.size());  // of each observation
    parallel_ranges(
        static_cast<int64_t>(model.points.size()), 1 << 12, [&](int64_t begin, int64_t end) {
            for (int64_t p = begin; p < end; ++p) {
                const PointRow& point = model.points[p];
                for (size_t k = 0; k < point.num_elements; ++k) {
                    const size_t i = point.first_element + k;
                    const TrackElement& element = model.elements[i];
                    const auto fail_here = [&](const auto&... parts) {
                        fail(Status::format, folder, ": the track of point ", point.info.id,
                             " names feature ", element.feature, " of image ", element.image, ", ",
                             parts...);
                    };
                    const int32_t row = image_rows.row(element.image);
                    if (row < 0) fail_here("but there is no such image");
                    const ImageRow& image = model.images[row];
                    if (element.feature >= image.num_features)
                        fail_here("but the image has ", image.num_features, " features");
                    features[i] = image.first_feature + element.feature;
                    const FeatureRow& feature = model.features[features[i]];
                    if (feature.point == no_point) fail_here("but that feature names no point");
                    if (feature.point != point.info.id)
                        fail_here("but that feature names point ", feature.point);
                    observations[i] = {row, static_cast<int32_t>(p), feature.x, feature.y};
                    made.observation_features[i] = static_cast<int32_t>(element.feature);
                }
            }
        });
    std::vector<char> is_taken(model.features.size());
    for (size_t i = 0; i < features.size(); ++i) {
        if (std::exchange(is_taken[features[i]], char{1}))
            fail(Status::format, folder, ": the track of point ",
                 model.points[observations[i].point].info.id, " names feature ",
                 made.observation_features[i], " of image ", model.images[observations[i].image].id,
                 " twice");
    }
    for (size_t i = 0; i < model.images.size(); ++i) {
        const ImageRow& image = model.images[i];
        for (size_t k = 0; k < image.num_features; ++k) {
            const FeatureRow& feature = model.features[image.first_feature + k];
            if (feature.point == no_point)
                made.unmatched.push_back(
                    {static_cast<int32_t>(i), static_cast<int32_t>(k), feature.x, feature.y});
            else if (!is_taken[image.first_feature + k])
                fail(Status::format, folder, ": feature ", k, " of image ", image.id,
                     " names point ", feature.point,
                     ", but there is no such point, or its track does not name the feature");
        }
    }
}

Reconstruction reconstruction_of(Model&& model, const std::string& folder) {
    require_rows(model.cameras.size(), "cameras", folder);
    require_rows(model.images.size(), "images", folder);
    require_rows(model.points.size(), "points", folder);
    require_rows(model.elements.size(), "observations", folder);
    Reconstruction made;
    Problem& problem = made.problem;
    const auto index_of = [&](const auto& rows, const char* what, const auto& id_of) {
        IdIndex index(rows.size(), [&](size_t i) { return id_of(rows[i]); });
        if (index.duplicate())
            fail(Status::format, folder, " has two ", what, " of the id ", *index.duplicate());
        return index;
    };
    const IdIndex camera_rows =
        index_of(model.cameras, "cameras", [](const auto& row) { return row.id; });
    const IdIndex image_rows =
        index_of(model.images, "images", [](const auto& row) { return row.id; });
    index_of(model.points, "points", [](const auto& row) { return row.info.id; });

    for (const colmap::CameraRow& row : model.cameras) {
        problem.cameras.push_back(row.camera);
        made.cameras.push_back({row.id, row.width, row.height});
    }
    for (ImageRow& row : model.images) {
        require_rows(row.num_features, "features in one image", folder);
        const int32_t camera = camera_rows.row(row.camera);
        if (camera < 0)
            fail(Status::format, folder, ": image ", row.id, " refers to camera ", row.camera,
                 ", but there is no such camera");
        problem.images.push_back({camera, normalized_pose(row.pose, folder, "image", row.id)});
        made.images.push_back({row.id, std::move(row.name)});
        made.poses_read.push_back(row.pose);
    }
    for (const PointRow& row : model.points) {
        problem.points.push_back(row.position);
        made.points.push_back(row.info);
    }
    made.has_frames = model.has_frames;
    made.rigs = std::move(model.rigs);
    made.frames = std::move(model.frames);
    if (made.has_frames) colmap::take_poses_from_frames(made, image_rows, folder);
    add_observations(model, image_rows, folder, made);
    made.digest_read = digest(problem);
    return made;
}

// The ids of rows, or 1, 2, ... where they have none that COLMAP can hold, each its own.
template <class Id, class Info>
std::vector<Id> ids_of(const std::vector<Info>& infos, size_t count) {
    std::vector<Id> ids(count);
    const bool fits =
        infos.size() == count && std::all_of(infos.begin(), infos.end(), [](const Info& info) {
            return info.id < std::numeric_limits<Id>::max();  // COLMAP's invalid id
        });
    for (size_t i = 0; i < count; ++i) ids[i] = static_cast<Id>(fits ? infos[i].id : i + 1);
    if (fits && IdIndex(count, [&](size_t i) { return ids[i]; }).duplicate())
        for (size_t i = 0; i < count; ++i) ids[i] = static_cast<Id>(i + 1);
    return ids;
}

std::string default_name(size_t image) {
    const std::string digits = std::to_string(image + 1);
    return "image" + std::string(digits.size() < 6 ? 6 - digits.size() : 0, '0') + digits;
}

// A feature of an image to be: an observation or, numbered on after them, an unmatched feature.
// Their index in the image is their rank by the index they have; without one, their order.
class FeatureOrder {
public:
    explicit FeatureOrder(const Reconstruction& reconstruction)
        : reconstruction_(reconstruction),
          num_observations_(reconstruction.problem.num_observations()) {
        const int64_t count =
            num_observations_ + static_cast<int64_t>(reconstruction.unmatched.size());
        require(count <= static_cast<int64_t>(most_rows), "there are ", count,
                " features, but a COLMAP model is written with no more than ", most_rows);
        order_.resize(static_cast<size_t>(count));
        begin_ = counting_sort(
            count, reconstruction.problem.num_images(), [&](int64_t i) { return image(i); },
            [&](int64_t i, int32_t slot) { order_[slot] = static_cast<int32_t>(i); });
        if (reconstruction.observation_features.empty()) return;
        parallel_ranges(reconstruction.problem.num_images(), 1, [&](int64_t begin, int64_t end) {
            for (int64_t i = begin; i < end; ++i)
                std::stable_sort(order_.begin() + begin_[i], order_.begin() + begin_[i + 1],
                                 [&](int32_t a, int32_t b) { return index(a) < index(b); });
        });
    }
    size_t first(size_t image) const { return static_cast<size_t>(begin_[image]); }
    size_t size() const { return order_.size(); }
    // -1: unmatched, which is then set.
    int32_t observation(size_t slot, const Feature*& unmatched) const {
        const int32_t i = order_[slot];
        if (i < num_observations_) return i;
        unmatched = &reconstruction_.unmatched[i - num_observations_];
        return -1;
    }

private:
    int32_t image(int64_t i) const {
        return i < num_observations_ ? reconstruction_.problem.observations[i].image
                                     : reconstruction_.unmatched[i - num_observations_].image;
    }
    int32_t index(int32_t i) const {
        return i < num_observations_ ? reconstruction_.observation_features[i]
                                     : reconstruction_.unmatched[i - num_observations_].index;
    }

    const Reconstruction& reconstruction_;
    int64_t num_observations_;
    std::vector<int32_t> order_;
    std::vector<int32_t> begin_;
};

void add_camera_rows(const Reconstruction& from, Model& model) {
    const auto ids = ids_of<uint32_t>(from.cameras, from.problem.cameras.size());
    for (size_t i = 0; i < ids.size(); ++i) {
        colmap::CameraRow row{ids[i], from.problem.cameras[i], 0, 0};
        if (!from.cameras.empty()) {
            row.width = from.cameras[i].width;
            row.height = from.cameras[i].height;
        }
        model.cameras.push_back(row);
    }
}

void add_image_rows(const Reconstruction& from, bool is_as_read, Model& model) {
    const Problem& problem = from.problem;
    const auto ids = ids_of<uint32_t>(from.images, problem.images.size());
    for (size_t i = 0; i < ids.size(); ++i) {
        ImageRow row;
        row.id = ids[i];
        row.camera = model.cameras[problem.images[i].camera].id;
        row.pose = is_as_read ? from.poses_read[i] : problem.images[i].pose;
        row.name = from.images.empty() || from.images[i].name.empty() ? default_name(i)
                                                                      : from.images[i].name;
        model.images.push_back(std::move(row));
    }
}

void add_feature_and_point_rows(const Reconstruction& from, bool is_as_read, Model& model) {
    const Problem& problem = from.problem;
    const auto ids = ids_of<uint64_t>(from.points, problem.points.size());
    const FeatureOrder order(from);
    std::vector<uint32_t> index(problem.observations.size());  // of each one's feature
    model.features.resize(order.size());
    parallel_ranges(problem.num_images(), 1, [&](int64_t begin, int64_t end) {
        for (auto i = static_cast<size_t>(begin); i < static_cast<size_t>(end); ++i) {
            ImageRow& image = model.images[i];
            image.first_feature = order.first(i);
            image.num_features = order.first(i + 1) - order.first(i);
            for (size_t k = 0; k < image.num_features; ++k) {
                const Feature* unmatched = nullptr;
                const size_t slot = image.first_feature + k;
                const int32_t row = order.observation(slot, unmatched);
                if (row < 0) {
                    model.features[slot] = {unmatched->x, unmatched->y, no_point};
                } else {
                    const Observation& o = problem.observations[row];
                    model.features[slot] = {o.x, o.y, ids[o.point]};
                    index[row] = static_cast<uint32_t>(k);
                }
            }
        }
    });

    model.elements.resize(problem.observations.size());
    const auto track_begin = counting_sort(
        problem.num_observations(), problem.num_points(),
        [&](int64_t i) { return problem.observations[i].point; },
        [&](int64_t i, int32_t slot) {
            model.elements[slot] = {model.images[problem.observations[i].image].id, index[i]};
        });
    const std::vector<double> errors =
        is_as_read ? std::vector<double>() : reference::mean_reprojection_errors(problem);
    model.points.resize(ids.size());
    for (size_t i = 0; i < ids.size(); ++i) {
        PointRow& row = model.points[i];
        if (!from.points.empty()) row.info = from.points[i];
        row.info.id = ids[i];
        if (!is_as_read) row.info.error = errors[i];
        row.position = problem.points[i];
        row.first_element = static_cast<size_t>(track_begin[i]);
        row.num_elements = static_cast<size_t>(track_begin[i + 1] - track_begin[i]);
    }
}

Model model_of(const Reconstruction& from) {
    const bool is_as_read = from.digest_read == digest(from.problem);
    Model model;
    add_camera_rows(from, model);
    add_image_rows(from, is_as_read, model);
    add_feature_and_point_rows(from, is_as_read, model);
    model.has_frames = from.has_frames;
    model.rigs = from.rigs;
    model.frames = from.frames;
    if ((from.has_frames || !from.problem.rigs.empty()) && !is_as_read)
        colmap::update_frames(from.problem, model);
    return model;
}

bool has_file(const std::string& folder, const char* name) {
    std::error_code error;
    return std::filesystem::exists(folder + "/" + name, error);
}

void write(const Reconstruction& reconstruction, const std::string& folder, bool as_text) {
    if (as_text ? has_colmap_binary(folder) : has_colmap_text(folder))
        fail(Status::file, "cannot write a COLMAP ", as_text ? "text" : "binary", " model to ",
             folder, ": it holds a ", as_text ? "binary" : "text",
             " one, and readers would take one of the two; name another folder");
    std::optional<Reconstruction> converted;
    if (!has_colmap_cameras_only(reconstruction.problem))
        converted = with_colmap_cameras(reconstruction);
    const Model model = model_of(converted ? *converted : reconstruction);
    OutputFolder output(folder);
    (as_text ? colmap::write_text : colmap::write_binary)(model, output);
    output.commit();
}

}  // namespace

Reconstruction read_colmap_binary(const std::string& folder) {
    return reconstruction_of(colmap::read_binary(folder), folder);
}

Reconstruction read_colmap_text(const std::string& folder) {
    return reconstruction_of(colmap::read_text(folder), folder);
}

bool has_colmap_binary(const std::string& folder) {
    return has_file(folder, "cameras.bin") || has_file(folder, "images.bin") ||
           has_file(folder, "points3D.bin");
}

bool has_colmap_text(const std::string& folder) {
    return has_file(folder, "cameras.txt") || has_file(folder, "images.txt") ||
           has_file(folder, "points3D.txt");
}

void write_colmap_binary(const Reconstruction& reconstruction, const std::string& folder) {
    write(reconstruction, folder, false);
}

void write_colmap_text(const Reconstruction& reconstruction, const std::string& folder) {
    write(reconstruction, folder, true);
}

}  // namespace clba
