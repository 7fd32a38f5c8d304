// SPDX-License-Identifier: Apache-2.0
#include "io/opensfm.hpp"

#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <unordered_map>
#include <unordered_set>

#include "base/error.hpp"
#include "io/camera_forms.hpp"
#include "io/convert.hpp"
#include "io/json_document.hpp"
#include "io/number_reader.hpp"
#include "io/opensfm_cameras.hpp"
#include "io/opensfm_tracks.hpp"
#include "io/text_input.hpp"
#include "io/text_output.hpp"

namespace clba {
namespace {

// Copied as they are, where they lie beside a reconstruction.
constexpr const char* const ground_control_files[] = {"ground_control_points.json", "gcp_list.txt"};

// OpenSfM's reprojection_error_sd, for features without a scale of their own.
constexpr double default_scale = 0.004;

struct OpenSfmDetails final : SourceDetails {
    OpenSfmDetails() : SourceDetails("opensfm") {}
    Json document;
    OpenSfmTracks tracks;
    std::vector<int32_t> image_of_name, point_of_track;  // -1: not reconstructed
    std::vector<int64_t> observation_of_row;  // -1: its image or its track is not reconstructed
    std::vector<std::pair<std::string, std::string>> ground_control;  // names and contents
};

struct Paths {
    std::string folder, reconstruction, tracks;
};

std::string replaced(std::string name, std::string_view from, std::string_view to) {
    const size_t position = name.rfind(from);
    return position == std::string::npos ? name : name.replace(position, from.size(), to);
}

Paths paths_of(const std::string& path) {
    const std::filesystem::path whole(path);
    const std::string file = whole.filename().string();
    std::error_code error;
    if (std::filesystem::is_directory(whole, error) || file.find(".json") == std::string::npos)
        return {path, (whole / "reconstruction.json").string(), (whole / "tracks.csv").string()};
    const std::string tracks =
        file.find("reconstruction") == std::string::npos
            ? "tracks.csv"
            : replaced(replaced(file, ".json", ".csv"), "reconstruction", "tracks");
    const std::filesystem::path folder = whole.parent_path();
    return {folder.string(), path, (folder / tracks).string()};
}

using IndexByName = std::unordered_map<std::string, int32_t>;

void add_name(IndexByName& names, const JsonPlace& place, const std::string& name, int32_t index) {
    if (!names.emplace(name, index).second) place.fail_here("occurs twice");
}

IndexByName read_cameras(const JsonPlace& cameras, Reconstruction& result) {
    IndexByName names;
    const size_t count = cameras.members().size();
    for (size_t c = 0; c < count; ++c) {
        const JsonPlace place = cameras.member(c);
        OpenSfmCamera read = read_opensfm_camera(place);
        read.info.id = c;
        add_name(names, place, cameras.members()[c].first, static_cast<int32_t>(c));
        result.problem.cameras.push_back(read.camera);
        result.problem.constant_cameras.push_back(read.constant);
        result.cameras.push_back(read.info);
    }
    return names;
}

Pose pose_of(const JsonPlace& place) {
    Pose pose;
    pose.rotation = quaternion_from_rotation_vector(place["rotation"].numbers<3>());
    if (!std::isfinite(pose.rotation[0])) place["rotation"].fail_here("is too long a vector");
    if (place.find("translation")) pose.translation = place["translation"].numbers<3>();
    return pose;
}

IndexByName read_shots(const JsonPlace& shots, const IndexByName& cameras, Reconstruction& result) {
    IndexByName names;
    const size_t count = shots.members().size();
    for (size_t i = 0; i < count; ++i) {
        const JsonPlace place = shots.member(i);
        const std::string& name = shots.members()[i].first;
        const JsonPlace camera_name = place["camera"];
        const auto camera = cameras.find(camera_name.string());
        if (camera == cameras.end())
            camera_name.fail_here("is '", shown(camera_name.string()),
                                  "', but there is no such camera");
        Image image;
        image.camera = camera->second;
        image.pose = pose_of(place);
        add_name(names, place, name, static_cast<int32_t>(i));
        result.problem.images.push_back(image);
        result.images.push_back({i, name});
    }
    return names;
}

int64_t count_gps_positions(const JsonPlace& shots) {
    int64_t count = 0;
    for (size_t i = 0; i < shots.members().size(); ++i) {
        const Json* position = shots.member(i).find("gps_position");
        count += position && position->is_array();
    }
    return count;
}

// Each shot must stand where its rig does.
void check_rigs(const JsonPlace& reconstruction) {
    if (!reconstruction.find("rig_instances")) return;
    if (reconstruction.find("rig_cameras")) {
        const JsonPlace cameras = reconstruction["rig_cameras"];
        for (size_t c = 0; c < cameras.members().size(); ++c) {
            const JsonPlace camera = cameras.member(c);
            for (const char* name : {"rotation", "translation"})
                for (double value : camera[name].numbers<3>())
                    if (value != 0)
                        camera.fail_here(
                            "has a pose of its own on its rig; rigs of several cameras "
                            "cannot be read");
        }
    }
    const JsonPlace instances = reconstruction["rig_instances"];
    for (size_t i = 0; i < instances.members().size(); ++i) {
        const JsonPlace instance = instances.member(i);
        const JsonPlace shots = instance["rig_camera_ids"];
        if (shots.members().size() > 1)
            shots.fail_here("has ", shots.members().size(),
                            " shots; rigs of several cameras cannot be read");
    }
}

IndexByName read_points(const JsonPlace& points, Reconstruction& result) {
    IndexByName names;
    const size_t count = points.members().size();
    for (size_t p = 0; p < count; ++p) {
        const JsonPlace place = points.member(p);
        const std::string& name = points.members()[p].first;
        add_name(names, place, name, static_cast<int32_t>(p));
        PointInfo info;
        int64_t id = 0;
        info.id = parse_integer(name, id) == IntegerParse::ok && id >= 0 ? static_cast<uint64_t>(id)
                                                                         : static_cast<uint64_t>(p);
        if (place.find("color")) {
            const std::array<double, 3> color = place["color"].numbers<3>();
            for (int k = 0; k < 3; ++k)
                info.color[k] = static_cast<uint8_t>(std::clamp(std::round(color[k]), 0.0, 255.0));
        }
        result.problem.points.push_back(place["coordinates"].numbers<3>());
        result.points.push_back(info);
    }
    return names;
}

std::array<double, 2> pixel_of(const OpenSfmScale& scale, const OpenSfmTrackRow& row) {
    return {row.x * scale.size + scale.center_x, row.y * scale.size + scale.center_y};
}

OpenSfmScale scale_of(const Reconstruction& reconstruction, int32_t image) {
    const CameraInfo& info = reconstruction.cameras[reconstruction.problem.images[image].camera];
    return {info.width, info.height};
}

void read_observations(const std::string& path, const IndexByName& shots, const IndexByName& points,
                       OpenSfmDetails& details, Reconstruction& result) {
    const auto indices = [](const std::vector<std::string>& names, const IndexByName& known) {
        std::vector<int32_t> found;
        for (const std::string& name : names) {
            const auto entry = known.find(name);
            found.push_back(entry == known.end() ? -1 : entry->second);
        }
        return found;
    };
    details.image_of_name = indices(details.tracks.images, shots);
    details.point_of_track = indices(details.tracks.tracks, points);
    for (const OpenSfmTrackRow& row : details.tracks.rows) {
        const int32_t image = details.image_of_name[row.image];
        const int32_t point = details.point_of_track[row.track];
        if (image < 0 || point < 0) {
            details.observation_of_row.push_back(-1);
            continue;
        }
        const std::array<double, 2> pixel = pixel_of(scale_of(result, image), row);
        if (!std::isfinite(pixel[0]) || !std::isfinite(pixel[1]))
            fail(Status::format, path, ": the feature ", row.feature, " of ",
                 shown(details.tracks.images[row.image]), " lies at ", row.x, ", ", row.y,
                 ", but coordinates are shares of the image's size");
        details.observation_of_row.push_back(result.problem.num_observations());
        result.problem.observations.push_back({image, point, pixel[0], pixel[1]});
        result.observation_features.push_back(row.feature);
    }
}

// The tracks of a problem that was not read from any.
OpenSfmTracks new_tracks(const Reconstruction& reconstruction, const Json& shots,
                         std::vector<int64_t>& observation_of_row) {
    const Problem& problem = reconstruction.problem;
    OpenSfmTracks tracks;
    for (const auto& shot : static_cast<const JsonObject&>(shots.get_ref<const Json::object_t&>()))
        tracks.images.push_back(shot.first);
    for (int32_t p = 0; p < problem.num_points(); ++p) tracks.tracks.push_back(text(p));
    std::vector<int32_t> next_feature(problem.images.size(), 0);
    for (int64_t i = 0; i < problem.num_observations(); ++i) {
        const Observation& o = problem.observations[i];
        OpenSfmTrackRow row;
        row.image = o.image;
        row.track = o.point;
        row.feature = reconstruction.observation_features.empty()
                          ? next_feature[o.image]++
                          : reconstruction.observation_features[i];
        row.scale = default_scale;
        if (!reconstruction.points.empty())
            for (int k = 0; k < 3; ++k) row.color[k] = reconstruction.points[o.point].color[k];
        tracks.rows.push_back(row);
        observation_of_row.push_back(i);
    }
    return tracks;
}

Json new_document(const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    Json cameras = Json::object(), shots = Json::object();
    for (int32_t c = 0; c < problem.num_cameras(); ++c)
        set_member(cameras, text("camera", c).c_str(), Json::object());
    std::unordered_set<std::string> names;
    auto& members = static_cast<JsonObject&>(shots.get_ref<Json::object_t&>());
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        std::string name = reconstruction.images.empty() ? "" : reconstruction.images[i].name;
        if (name.empty()) name = text("image", i);
        require(names.insert(name).second, "images[", i, "] has the name '", shown(name),
                "', as an image before it has, but shots in OpenSfM have names of their own");
        for (char c : name)
            require(c != '\t' && c != '\n' && c != '\r', "the name of images[", i, "], '",
                    shown(name),
                    "', has a tab or a line break in it, which OpenSfM's tracks cannot hold");
        Json shot = Json::object();
        set_member(shot, "rotation", Json::array());
        set_member(shot, "translation", Json::array());
        set_member(shot, "camera", text("camera", problem.images[i].camera));
        members.emplace_back(name, std::move(shot));
    }
    Json whole = Json::object();
    set_member(whole, "cameras", std::move(cameras));
    set_member(whole, "shots", std::move(shots));
    set_member(whole, "points", Json::object());
    return Json::array({std::move(whole)});
}

bool has_pose(const Json& json, const Pose& pose) {
    const auto vector = [&](const char* name) {
        std::array<double, 3> values{};
        if (json.contains(name) && json[name].size() == 3)
            for (size_t k = 0; k < 3; ++k) values[k] = json[name][k].get<double>();
        return values;
    };
    return json.contains("rotation") && json["rotation"].size() == 3 &&
           quaternion_from_rotation_vector(vector("rotation")) == pose.rotation &&
           vector("translation") == pose.translation;
}

void set_pose(Json& json, const Pose& pose) {
    const std::array<double, 3> rotation = rotation_vector_from_quaternion(pose.rotation);
    set_member(json, "rotation", rotation);
    set_member(json, "translation", pose.translation);
}

// What is written of the first reconstruction of the document but its points.
void update(Json& json, const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    size_t c = 0;
    for (auto& [name, camera] :
         static_cast<JsonObject&>(json["cameras"].get_ref<Json::object_t&>())) {
        const CameraInfo info =
            reconstruction.cameras.empty() ? CameraInfo{} : reconstruction.cameras[c];
        set_opensfm_camera(camera, problem.cameras[c], info, static_cast<int32_t>(c));
        ++c;
    }
    std::unordered_map<std::string, const Pose*> moved;
    size_t i = 0;
    for (auto& [name, shot] : static_cast<JsonObject&>(json["shots"].get_ref<Json::object_t&>())) {
        const Pose& pose = problem.images[i++].pose;
        if (has_pose(shot, pose)) continue;
        set_pose(shot, pose);
        moved.emplace(name, &pose);
    }
    if (!json.contains("rig_instances")) return;
    for (auto& [name, instance] :
         static_cast<JsonObject&>(json["rig_instances"].get_ref<Json::object_t&>())) {
        const Json& shots = instance["rig_camera_ids"];
        if (shots.empty()) continue;
        const auto pose = moved.find(shots.begin().key());
        if (pose != moved.end()) set_pose(instance, *pose->second);
    }
}

void put_points(JsonOutput& output, const Json& read, const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    const auto& members = static_cast<const JsonObject&>(read.get_ref<const Json::object_t&>());
    output.begin('{');
    for (size_t p = 0; p < problem.points.size(); ++p) {
        if (members.empty()) {
            const PointInfo info =
                reconstruction.points.empty() ? PointInfo{} : reconstruction.points[p];
            output.key(text(p)).begin('{');
            output.key("color").put(std::array<double, 3>{static_cast<double>(info.color[0]),
                                                          static_cast<double>(info.color[1]),
                                                          static_cast<double>(info.color[2])});
            output.key("coordinates").put(problem.points[p]);
            output.end();
            continue;
        }
        output.key(members[p].first).begin('{');
        for (const auto& [name, value] :
             static_cast<const JsonObject&>(members[p].second.get_ref<const Json::object_t&>())) {
            output.key(name);
            if (name == "coordinates")
                output.put(problem.points[p]);
            else
                output.put(value);
        }
        output.end();
    }
    output.end();
}

void put_document(TextOutput& file, const Json& document, const Json& first, const Json& points,
                  const Reconstruction& reconstruction) {
    JsonOutput output(file);
    output.begin('[');
    output.begin('{');
    for (const auto& [name, value] :
         static_cast<const JsonObject&>(first.get_ref<const Json::object_t&>())) {
        output.key(name);
        if (name == "points")
            put_points(output, points, reconstruction);
        else
            output.put(value);
    }
    output.end();
    for (size_t i = 1; i < document.size(); ++i) output.put(document[i]);
    output.end();
    file.put("\n");
}

// Rows whose observations have not been set anew keep their coordinates.
void update(OpenSfmTracks& tracks, const std::vector<int64_t>& observation_of_row,
            const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    for (size_t r = 0; r < tracks.rows.size(); ++r) {
        if (observation_of_row[r] < 0) continue;
        const Observation& o = problem.observations[observation_of_row[r]];
        OpenSfmTrackRow& row = tracks.rows[r];
        const OpenSfmScale scale = scale_of(reconstruction, o.image);
        const std::array<double, 2> read = pixel_of(scale, row);
        if (read[0] != o.x) row.x = (o.x - scale.center_x) / scale.size;
        if (read[1] != o.y) row.y = (o.y - scale.center_y) / scale.size;
    }
}

// Whether the rows are still those that were read.
bool fits(const OpenSfmDetails& details, const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    const Json& first = details.document[0];
    if (first["cameras"].size() != problem.cameras.size() ||
        first["shots"].size() != problem.images.size() ||
        (first.contains("points") ? first["points"].size() : 0) != problem.points.size() ||
        reconstruction.cameras.size() != problem.cameras.size())
        return false;
    int64_t num_observations = 0;
    for (size_t r = 0; r < details.tracks.rows.size(); ++r) {
        const int64_t i = details.observation_of_row[r];
        if (i < 0) continue;
        ++num_observations;
        if (i >= problem.num_observations()) return false;
        const OpenSfmTrackRow& row = details.tracks.rows[r];
        if (problem.observations[i].image != details.image_of_name[row.image] ||
            problem.observations[i].point != details.point_of_track[row.track])
            return false;
    }
    return num_observations == problem.num_observations();
}

class MadeFolder {
public:
    explicit MadeFolder(const std::string& path) : path_(path) {
        std::error_code error;
        is_made_ = !path.empty() && std::filesystem::create_directory(path, error);
        if (error)
            fail(Status::file, "cannot make the folder ", path, ": ", error.message(),
                 "; the one it is to be in must exist and be writable");
    }
    ~MadeFolder() {
        std::error_code error;
        if (is_made_) std::filesystem::remove(path_, error);
    }
    MadeFolder(const MadeFolder&) = delete;
    MadeFolder& operator=(const MadeFolder&) = delete;
    void keep() { is_made_ = false; }

private:
    std::string path_;
    bool is_made_ = false;
};

}  // namespace

bool has_opensfm(const std::string& folder) {
    const Paths paths = paths_of(folder);
    std::error_code error;
    return std::filesystem::is_regular_file(paths.reconstruction, error) &&
           std::filesystem::is_regular_file(paths.tracks, error);
}

Reconstruction read_opensfm(const std::string& path) {
    const Paths paths = paths_of(path);
    auto details = std::make_shared<OpenSfmDetails>();
    details->document = read_json(paths.reconstruction);
    const JsonPlace root(paths.reconstruction, details->document);
    if (root.size() == 0) root.fail_here("holds no reconstruction");
    const JsonPlace first = root.at(0);
    Reconstruction result;
    const IndexByName cameras = read_cameras(first["cameras"], result);
    const IndexByName shots = read_shots(first["shots"], cameras, result);
    check_rigs(first);
    IndexByName points;
    if (first.find("points")) points = read_points(first["points"], result);
    details->tracks = read_opensfm_tracks(paths.tracks);
    read_observations(paths.tracks, shots, points, *details, result);
    for (const char* name : ground_control_files) {
        const std::filesystem::path file = std::filesystem::path(paths.folder) / name;
        std::error_code error;
        if (std::filesystem::is_regular_file(file, error))
            details->ground_control.emplace_back(name, read_text(file.string()));
    }
    const int64_t num_gps = count_gps_positions(first["shots"]);
    if (num_gps > 0)
        result.notices.push_back(text("the GPS positions of ", num_gps,
                                      " shots are kept as they are; to solve with them, give them "
                                      "as priors of positions"));
    if (!details->ground_control.empty())
        result.notices.push_back(
            text(details->ground_control[0].first,
                 " is kept as it is; to solve with ground control, give it as priors of points"));
    if (root.size() > 1)
        result.notices.push_back(
            text("the first of ", root.size(),
                 " reconstructions was read; the others are kept as they are"));
    const auto num_kept =
        static_cast<int64_t>(details->tracks.rows.size()) - result.problem.num_observations();
    if (num_kept > 0)
        result.notices.push_back(text(num_kept, " of ", details->tracks.rows.size(),
                                      " features belong to no shot or no point; they are kept as "
                                      "they are"));
    result.details = std::move(details);
    return result;
}

void write_opensfm(const Reconstruction& reconstruction, const std::string& path) {
    if (has_snavely_cameras(reconstruction.problem)) {
        write_opensfm(with_pixel_cameras(reconstruction), path);
        return;
    }
    const Paths paths = paths_of(path);
    const auto* details = dynamic_cast<const OpenSfmDetails*>(reconstruction.details.get());
    if (details && !fits(*details, reconstruction)) details = nullptr;
    const Json document = details ? Json() : new_document(reconstruction);
    const Json& whole = details ? details->document : document;
    Json first = Json::object();
    auto& members = static_cast<JsonObject&>(first.get_ref<Json::object_t&>());
    const Json no_points = Json::object();
    const Json* points = &no_points;
    for (const auto& [name, value] :
         static_cast<const JsonObject&>(whole[0].get_ref<const Json::object_t&>()))
        if (name == "points") {
            points = &value;
            members.emplace_back("points", Json::object());
        } else {
            members.emplace_back(name, value);
        }
    update(first, reconstruction);
    std::vector<int64_t> observation_of_row;
    OpenSfmTracks tracks =
        details ? details->tracks : new_tracks(reconstruction, first["shots"], observation_of_row);
    update(tracks, details ? details->observation_of_row : observation_of_row, reconstruction);

    MadeFolder folder(paths.folder);
    TextOutput reconstruction_file(paths.reconstruction), tracks_file(paths.tracks);
    put_document(reconstruction_file, whole, first, *points, reconstruction);
    put_opensfm_tracks(tracks_file, tracks);
    std::vector<std::unique_ptr<TextOutput>> copies;
    if (details)
        for (const auto& [name, content] : details->ground_control) {
            copies.push_back(std::make_unique<TextOutput>(
                (std::filesystem::path(paths.folder) / name).string()));
            copies.back()->put(content);
        }
    for (const auto& copy : copies) copy->commit();
    tracks_file.commit();
    reconstruction_file.commit();
    folder.keep();
}

}  // namespace clba
