// SPDX-License-Identifier: Apache-2.0
#include "io/openmvg.hpp"

#include <array>
#include <limits>
#include <optional>
#include <unordered_map>
#include <unordered_set>

#include "base/error.hpp"
#include "io/camera_forms.hpp"
#include "io/convert.hpp"
#include "io/json_document.hpp"
#include "io/openmvg_intrinsics.hpp"
#include "io/text_input.hpp"
#include "problem/counting_sort.hpp"

namespace clba {
namespace {

using openmvg::camera_of;
using openmvg::constant_params;
using openmvg::holds;
using openmvg::Intrinsic;
using openmvg::row_of;
using openmvg::Type;
using openmvg::type_of;
using openmvg::TypeRow;

// Cereal numbers the types and the objects of shared pointers from 1 and marks the first use of a
// number by its highest bit; exact_type stands for a pointer to the declared type itself.
constexpr int64_t first_use = int64_t{1} << 31;
constexpr int64_t exact_type = int64_t{1} << 30;
constexpr int64_t most_id = std::numeric_limits<uint32_t>::max();

struct OpenMvgDetails final : SourceDetails {
    OpenMvgDetails() : SourceDetails("openmvg") {}
    Json document;                                 // its structure emptied
    std::vector<std::string> view_types;           // of each view; empty: View itself
    std::vector<std::string> intrinsic_types;      // of each intrinsic
    std::vector<Camera> cameras;                   // of each intrinsic, as read
    std::vector<size_t> pose_entries;              // of each image, in the extrinsics
    std::vector<std::array<double, 9>> rotations;  // of each image, as read
    std::vector<std::array<double, 3>> centers;
};

// The names of types by their numbers, which cereal gives once.
class TypeNames {
public:
    std::string read(const JsonPlace& value) {
        if (!value.find("polymorphic_id")) return {};  // views of versions before 0.3
        const int64_t id = value["polymorphic_id"].integer(0, most_id);
        if (id == exact_type) return {};
        if (id & first_use) return names_[id - first_use] = value["polymorphic_name"].string();
        const auto found = names_.find(id);
        if (found == names_.end())
            value.fail_here("has the polymorphic_id ", id,
                            ", but no entry before it names that type");
        return found->second;
    }

private:
    std::unordered_map<int64_t, std::string> names_;
};

class Numbering {
public:
    void set(Json& value, const std::string& type) {
        if (type.empty()) {
            set_member(value, "polymorphic_id", exact_type);
        } else {
            const auto [entry, is_new] = types_.emplace(type, types_.size() + 1);
            set_member(value, "polymorphic_id", entry->second + (is_new ? first_use : 0));
            auto& members = static_cast<JsonObject&>(value.get_ref<Json::object_t&>());
            for (size_t i = 0; i < members.size(); ++i)
                if (members[i].first == "polymorphic_name") {
                    remove(members, i);
                    break;
                }
            if (is_new) insert_name(members, type);
        }
        set_member(value["ptr_wrapper"], "id", first_use + ++num_objects_);
    }

private:
    // The keys of members cannot be assigned, so the list is made anew.
    static void remove(JsonObject& members, size_t index) {
        JsonObject kept;
        for (size_t i = 0; i < members.size(); ++i)
            if (i != index) kept.emplace_back(members[i].first, std::move(members[i].second));
        members.swap(kept);
    }
    static void insert_name(JsonObject& members, const std::string& type) {
        JsonObject longer;
        for (auto& [key, value] : members) {
            const bool is_id = key == "polymorphic_id";
            longer.emplace_back(key, std::move(value));
            if (is_id) longer.emplace_back("polymorphic_name", type);
        }
        members.swap(longer);
    }

    std::unordered_map<std::string, int64_t> types_;
    int64_t num_objects_ = 0;
};

using IndexById = std::unordered_map<int64_t, int32_t>;

void add_id(IndexById& ids, const JsonPlace& entry, int64_t id, int32_t index) {
    if (!ids.emplace(id, index).second)
        entry.fail_here("has the key ", id, ", as one before it has");
}

IndexById read_intrinsics(const JsonPlace& intrinsics, TypeNames& names, OpenMvgDetails& details,
                          Reconstruction& result) {
    IndexById ids;
    Problem& problem = result.problem;
    int32_t num_fisheyes = 0;
    for (size_t i = 0; i < intrinsics.size(); ++i) {
        const JsonPlace entry = intrinsics.at(i);
        const JsonPlace value = entry["value"];
        const std::string name = names.read(value);
        const std::optional<Type> type = type_of(name);
        if (!type)
            value.fail_here("is an intrinsic of the type '", shown(name),
                            "', but only pinhole, pinhole_radial_k1, pinhole_radial_k3, "
                            "pinhole_brown_t2 and fisheye can be read");
        const JsonPlace wrapper = value["ptr_wrapper"];
        const JsonPlace data = wrapper["data"];
        CameraInfo info;
        info.id = static_cast<uint64_t>(entry["key"].integer(0, most_id));
        info.width = static_cast<uint64_t>(data["width"].integer(0, most_id));
        info.height = static_cast<uint64_t>(data["height"].integer(0, most_id));
        add_id(ids, entry, static_cast<int64_t>(info.id), problem.num_cameras());
        const TypeRow& row = row_of(*type);
        Intrinsic intrinsic{
            *type, data["focal_length"].number(), data["principal_point"].numbers<2>(), {}};
        if (row.distortion) {
            const JsonPlace numbers = data[row.distortion];
            numbers.expect_size(row.num_distortion);
            for (size_t k = 0; k < row.num_distortion; ++k)
                intrinsic.distortion[k] = numbers.at(k).number();
        }
        const Camera camera = camera_of(intrinsic);
        problem.cameras.push_back(camera);
        problem.constant_cameras.push_back(constant_params(intrinsic, camera));
        num_fisheyes += camera.model == camera_opencv_fisheye;
        result.cameras.push_back(info);
        details.intrinsic_types.push_back(name);
    }
    if (num_fisheyes > 0)
        result.notices.push_back(text("the focal lengths of ", num_fisheyes,
                                      " fisheye intrinsics are constant: an intrinsic has one, the "
                                      "model opencv_fisheye two, which a solve would part"));
    details.cameras = problem.cameras;
    return ids;
}

struct FilePose {
    std::array<double, 9> rotation;
    std::array<double, 3> center;
};

FilePose read_pose(const JsonPlace& value) {
    FilePose pose;
    const JsonPlace rows = value["rotation"];
    rows.expect_size(3);
    for (size_t row = 0; row < 3; ++row) {
        const JsonPlace place = rows.at(row);
        const auto numbers = place.numbers<3>();
        std::copy(numbers.begin(), numbers.end(), pose.rotation.begin() + 3 * row);
    }
    pose.center = value["center"].numbers<3>();
    if (!is_rotation(pose.rotation))
        rows.fail_here(
            "is no rotation: its rows must have length 1 and right angles to 1e-3, and a "
            "positive determinant");
    return pose;
}

Pose pose_of(const FilePose& read) {
    Pose pose;
    pose.rotation = quaternion_from_matrix(read.rotation);
    pose.translation = translation_from_center(pose.rotation, read.center);
    return pose;
}

struct ReadViews {
    IndexById image_by_view;  // -1: without a pose or an intrinsic
};

ReadViews read_views(const JsonPlace& views, const JsonPlace& extrinsics, TypeNames& names,
                     const JsonPlace& intrinsics, OpenMvgDetails& details, Reconstruction& result) {
    ReadViews read;
    for (size_t i = 0; i < views.size(); ++i) {
        const JsonPlace entry = views.at(i);
        details.view_types.push_back(names.read(entry["value"]));
    }
    const IndexById cameras = read_intrinsics(intrinsics, names, details, result);
    IndexById poses;
    for (size_t i = 0; i < extrinsics.size(); ++i) {
        const JsonPlace entry = extrinsics.at(i);
        add_id(poses, entry, entry["key"].integer(0, most_id), static_cast<int32_t>(i));
    }
    std::unordered_set<int32_t> used_poses;
    for (size_t i = 0; i < views.size(); ++i) {
        const JsonPlace entry = views.at(i);
        const JsonPlace value = entry["value"];
        const JsonPlace wrapper = value["ptr_wrapper"];
        const JsonPlace data = wrapper["data"];
        const int64_t id = entry["key"].integer(0, most_id);
        const auto pose = poses.find(data["id_pose"].integer(0, most_id));
        const auto camera = cameras.find(data["id_intrinsic"].integer(0, most_id));
        if (pose == poses.end() || camera == cameras.end()) {
            add_id(read.image_by_view, entry, id, -1);
            continue;
        }
        if (!used_poses.insert(pose->second).second)
            data.fail_here("has the id_pose ", pose->first,
                           ", as a view before it has; poses that views share cannot be read");
        add_id(read.image_by_view, entry, id, result.problem.num_images());
        const JsonPlace extrinsic = extrinsics.at(static_cast<size_t>(pose->second));
        const FilePose file_pose = read_pose(extrinsic["value"]);
        Image image;
        image.camera = camera->second;
        image.pose = pose_of(file_pose);
        for (double t : image.pose.translation)
            if (!std::isfinite(t)) extrinsic.fail_here("has a centre too far away");
        result.problem.images.push_back(image);
        details.pose_entries.push_back(static_cast<size_t>(pose->second));
        details.rotations.push_back(file_pose.rotation);
        details.centers.push_back(file_pose.center);
        const std::string& folder = data["local_path"].string();
        result.images.push_back(
            {static_cast<uint64_t>(id), folder.empty() ? data["filename"].string()
                                                       : folder + "/" + data["filename"].string()});
    }
    return read;
}

void read_structure(const JsonPlace& structure, const IndexById& image_by_view,
                    Reconstruction& result) {
    Problem& problem = result.problem;
    IndexById ids;
    for (size_t p = 0; p < structure.size(); ++p) {
        const JsonPlace entry = structure.at(p);
        const JsonPlace value = entry["value"];
        PointInfo info;
        info.id = static_cast<uint64_t>(entry["key"].integer(0, most_id));
        add_id(ids, entry, static_cast<int64_t>(info.id), problem.num_points());
        const JsonPlace observations = value["observations"];
        for (size_t i = 0; i < observations.size(); ++i) {
            const JsonPlace observation = observations.at(i);
            const int64_t view = observation["key"].integer(0, most_id);
            const auto image = image_by_view.find(view);
            if (image == image_by_view.end() || image->second < 0)
                observation.fail_here("is made by the view ", view,
                                      image == image_by_view.end()
                                          ? ", but there is none with that key"
                                          : ", but that has no pose or no intrinsic");
            const JsonPlace made = observation["value"];
            const std::array<double, 2> x = made["x"].numbers<2>();
            problem.observations.push_back({image->second, problem.num_points(), x[0], x[1]});
            // A feature's id has 32 bits without a sign; the undefined one comes out as -1.
            result.observation_features.push_back(
                static_cast<int32_t>(static_cast<uint32_t>(made["id_feat"].integer(0, most_id))));
        }
        problem.points.push_back(value["X"].numbers<3>());
        result.points.push_back(info);
    }
}

// The ids of rows, or their indices where an id has more than the 32 bits of OpenMVG's.
template <class Info>
std::vector<int64_t> ids_of(const std::vector<Info>& infos, size_t count) {
    std::vector<int64_t> ids;
    for (const Info& info : infos) {
        if (info.id >= static_cast<uint64_t>(most_id)) break;
        ids.push_back(static_cast<int64_t>(info.id));
    }
    if (ids.size() == count) return ids;
    ids.resize(count);
    for (size_t i = 0; i < count; ++i) ids[i] = static_cast<int64_t>(i);
    return ids;
}

void put_structure(JsonOutput& output, const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    const std::vector<int64_t> view_ids = ids_of(reconstruction.images, problem.images.size());
    const std::vector<int64_t> point_ids = ids_of(reconstruction.points, problem.points.size());
    std::vector<int32_t> by_point(problem.observations.size());
    const std::vector<int32_t> begin = counting_sort(
        problem.num_observations(), problem.num_points(),
        [&](int64_t i) { return problem.observations[i].point; },
        [&](int64_t i, int32_t slot) { by_point[slot] = static_cast<int32_t>(i); });
    std::vector<int64_t> next_feature(problem.images.size(), 0);
    output.begin('[');
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        output.begin('{');
        output.key("key").put(point_ids[p]);
        output.key("value").begin('{');
        output.key("X").put(problem.points[p]);
        output.key("observations").begin('[');
        for (int32_t slot = begin[p]; slot < begin[p + 1]; ++slot) {
            const int32_t i = by_point[slot];
            const Observation& o = problem.observations[i];
            output.begin('{');
            output.key("key").put(view_ids[o.image]);
            output.key("value").begin('{');
            output.key("id_feat").put(
                reconstruction.observation_features.empty()
                    ? next_feature[o.image]++
                    : int64_t{static_cast<uint32_t>(reconstruction.observation_features[i])});
            output.key("x").put(std::array<double, 2>{o.x, o.y});
            output.end();
            output.end();
        }
        output.end();
        output.end();
        output.end();
    }
    output.end();
}

Intrinsic intrinsic_of(const Camera& camera, size_t index) {
    const std::optional<Intrinsic> intrinsic = openmvg::intrinsic_of(camera);
    require(
        intrinsic.has_value(), "cameras[", index, "] is a ", camera_models[camera.model].name,
        " camera that OpenMVG's intrinsics cannot hold: these have one focal length and k1, k2, "
        "k3, t1, t2 or a fisheye's k1 to k4; write another format");
    return *intrinsic;
}

void set_intrinsic(Json& data, Type type, const Intrinsic& intrinsic) {
    set_member(data, "focal_length", intrinsic.focal_length);
    set_member(data, "principal_point", intrinsic.center);
    const TypeRow& row = row_of(type);
    if (!row.distortion) return;
    Json values = Json::array();
    for (size_t k = 0; k < row.num_distortion; ++k) values.push_back(intrinsic.distortion[k]);
    set_member(data, row.distortion, std::move(values));
}

Json entry_of(int64_t key, Json value) {
    Json entry = Json::object();
    set_member(entry, "key", key);
    set_member(entry, "value", std::move(value));
    return entry;
}

Json pointer_to(Json data) {
    Json wrapper = Json::object();
    set_member(wrapper, "id", 0);
    set_member(wrapper, "data", std::move(data));
    Json value = Json::object();
    set_member(value, "polymorphic_id", exact_type);
    set_member(value, "ptr_wrapper", std::move(wrapper));
    return value;
}

// The problem's own document where none was read.
OpenMvgDetails new_details(const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    OpenMvgDetails details;
    const std::vector<int64_t> camera_ids = ids_of(reconstruction.cameras, problem.cameras.size());
    const std::vector<int64_t> image_ids = ids_of(reconstruction.images, problem.images.size());
    Json views = Json::array(), intrinsics = Json::array(), extrinsics = Json::array();
    for (int32_t c = 0; c < problem.num_cameras(); ++c) {
        Json data = Json::object();
        const CameraInfo info =
            reconstruction.cameras.empty() ? CameraInfo{} : reconstruction.cameras[c];
        set_member(data, "width", info.width);
        set_member(data, "height", info.height);
        intrinsics.push_back(entry_of(camera_ids[c], pointer_to(std::move(data))));
        details.intrinsic_types.emplace_back();
    }
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const Image& image = problem.images[i];
        const std::string name = reconstruction.images.empty() ? "" : reconstruction.images[i].name;
        const CameraInfo camera =
            reconstruction.cameras.empty() ? CameraInfo{} : reconstruction.cameras[image.camera];
        Json data = Json::object();
        set_member(data, "local_path", "");
        set_member(data, "filename", name);
        set_member(data, "width", camera.width);
        set_member(data, "height", camera.height);
        set_member(data, "id_view", image_ids[i]);
        set_member(data, "id_intrinsic", camera_ids[image.camera]);
        set_member(data, "id_pose", image_ids[i]);
        views.push_back(entry_of(image_ids[i], pointer_to(std::move(data))));
        details.view_types.emplace_back();
        details.pose_entries.push_back(static_cast<size_t>(i));
        extrinsics.push_back(entry_of(image_ids[i], Json::object()));
    }
    details.document = Json::object();
    set_member(details.document, "sfm_data_version", "0.3");
    set_member(details.document, "root_path", "");
    set_member(details.document, "views", std::move(views));
    set_member(details.document, "intrinsics", std::move(intrinsics));
    set_member(details.document, "extrinsics", std::move(extrinsics));
    set_member(details.document, "structure", Json::array());
    set_member(details.document, "control_points", Json::array());
    return details;
}

void set_pose(Json& value, const Problem& problem, size_t image, const OpenMvgDetails& details) {
    const Image& now = problem.images[image];
    if (image < details.rotations.size()) {
        const Pose read = pose_of({details.rotations[image], details.centers[image]});
        if (read.rotation == now.pose.rotation && read.translation == now.pose.translation) return;
    }
    const std::array<double, 9> r = rotation_matrix(now.pose.rotation);
    Json rows = Json::array();
    for (int row = 0; row < 3; ++row)
        rows.push_back(Json::array({r[3 * row], r[3 * row + 1], r[3 * row + 2]}));
    set_member(value, "rotation", std::move(rows));
    const Point center = camera_center(now.pose);
    set_member(value, "center", Json::array({center[0], center[1], center[2]}));
}

}  // namespace

Reconstruction read_openmvg(const std::string& path) {
    auto details = std::make_shared<OpenMvgDetails>();
    details->document = read_json(path);
    const JsonPlace root(path, details->document);
    const JsonPlace version = root["sfm_data_version"];
    if (version.string() < "0.1" || version.string() >= "0.4")
        version.fail_here("is '", shown(version.string()), "', but only 0.1 to 0.3 can be read");
    Reconstruction result;
    TypeNames names;
    const JsonPlace views = root["views"], intrinsics = root["intrinsics"];
    const JsonPlace extrinsics = root["extrinsics"], structure = root["structure"];
    const ReadViews read = read_views(views, extrinsics, names, intrinsics, *details, result);
    read_structure(structure, read.image_by_view, result);
    const size_t without = views.size() - result.images.size();
    if (without > 0)
        result.notices.push_back(
            text(without, " of ", views.size(),
                 " views have no pose or no intrinsic; they are kept as they are"));
    set_member(details->document, "structure", Json::array());
    result.details = std::move(details);
    return result;
}

void require_openmvg_cameras(const Problem& problem) {
    for (size_t c = 0; c < problem.cameras.size(); ++c)
        if (problem.cameras[c].model != camera_snavely) intrinsic_of(problem.cameras[c], c);
}

void write_openmvg(const Reconstruction& reconstruction, const std::string& path) {
    if (has_snavely_cameras(reconstruction.problem)) {
        write_openmvg(with_pixel_cameras(reconstruction), path);
        return;
    }
    const Problem& problem = reconstruction.problem;
    require(problem.num_observations() <= std::numeric_limits<int32_t>::max(), "there are ",
            problem.num_observations(), " observations, but at most 2^31 - 1 can be written");
    const auto* read = dynamic_cast<const OpenMvgDetails*>(reconstruction.details.get());
    const bool fits = read && read->cameras.size() == problem.cameras.size() &&
                      read->pose_entries.size() == problem.images.size() &&
                      reconstruction.images.size() == problem.images.size();
    OpenMvgDetails details = fits ? *read : new_details(reconstruction);
    Json& document = details.document;
    set_member(document, "sfm_data_version", "0.3");

    Numbering numbering;
    Json& views = document["views"];
    for (size_t i = 0; i < views.size(); ++i)
        numbering.set(views[i]["value"], details.view_types[i]);
    Json& intrinsics = document["intrinsics"];
    for (size_t c = 0; c < intrinsics.size(); ++c) {
        Json& value = intrinsics[c]["value"];
        const Camera& camera = problem.cameras[c];
        std::string name = details.intrinsic_types[c];
        if (c >= details.cameras.size() || camera.model != details.cameras[c].model ||
            camera.params != details.cameras[c].params) {
            const Intrinsic intrinsic = intrinsic_of(camera, c);
            const std::optional<Type> kept = type_of(name);
            const Type type = kept && holds(*kept, intrinsic) ? *kept : intrinsic.type;
            set_intrinsic(value["ptr_wrapper"]["data"], type, intrinsic);
            name = row_of(type).name;
        }
        numbering.set(value, name);
    }
    Json& extrinsics = document["extrinsics"];
    for (size_t i = 0; i < problem.images.size(); ++i)
        set_pose(extrinsics[details.pose_entries[i]]["value"], problem, i, details);

    TextOutput file(path);
    JsonOutput output(file);
    output.begin('{');
    for (const auto& [key, value] :
         static_cast<const JsonObject&>(document.get_ref<const Json::object_t&>())) {
        output.key(key);
        if (key == "structure")
            put_structure(output, reconstruction);
        else
            output.put(value);
    }
    output.end();
    file.put("\n");
    file.commit();
}

}  // namespace clba
