// SPDX-License-Identifier: Apache-2.0
#include "io/opensfm_cameras.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string_view>
#include <vector>

#include "io/camera_forms.hpp"
#include "io/text_input.hpp"

namespace clba {
namespace {

enum class Unit { size, center_x, center_y, none };

struct Member {
    const char* name;
    int param;
    Unit unit;
    bool is_optional;  // 0 where it is missing
};

struct ProjectionType {
    const char* name;
    CameraModelNumber model;
    int center;  // the parameter cx; cy follows it
    std::vector<Member> members;
};

const std::vector<ProjectionType>& projection_types() {
    static const Member fx{"focal_x", 0, Unit::size, false}, fy{"focal_y", 1, Unit::size, false};
    static const Member cx{"c_x", 2, Unit::center_x, true}, cy{"c_y", 3, Unit::center_y, true};
    static const std::vector<ProjectionType> all{
        {"perspective",
         camera_radial,
         1,
         {{"focal", 0, Unit::size, false},
          {"k1", 3, Unit::none, true},
          {"k2", 4, Unit::none, true}}},
        {"simple_radial", camera_opencv, 2, {fx, fy, cx, cy, {"k1", 4, Unit::none, true}}},
        {"radial",
         camera_opencv,
         2,
         {fx, fy, cx, cy, {"k1", 4, Unit::none, true}, {"k2", 5, Unit::none, true}}},
        {"brown",
         camera_full_opencv,
         2,
         {fx,
          fy,
          cx,
          cy,
          {"k1", 4, Unit::none, true},
          {"k2", 5, Unit::none, true},
          {"p1", 6, Unit::none, true},
          {"p2", 7, Unit::none, true},
          {"k3", 8, Unit::none, true}}},
        {"fisheye",
         camera_radial_fisheye,
         1,
         {{"focal", 0, Unit::size, false},
          {"k1", 3, Unit::none, true},
          {"k2", 4, Unit::none, true}}},
        {"fisheye_opencv",
         camera_opencv_fisheye,
         2,
         {fx,
          fy,
          cx,
          cy,
          {"k1", 4, Unit::none, true},
          {"k2", 5, Unit::none, true},
          {"k3", 6, Unit::none, true},
          {"k4", 7, Unit::none, true}}},
    };
    return all;
}

const ProjectionType* type_named(std::string_view name) {
    for (const ProjectionType& type : projection_types())
        if (type.name == name) return &type;
    return nullptr;
}

double to_param(const OpenSfmScale& scale, Unit unit, double value) {
    switch (unit) {
        case Unit::size:
            return value * scale.size;
        case Unit::center_x:
            return value * scale.size + scale.center_x;
        case Unit::center_y:
            return value * scale.size + scale.center_y;
        default:
            return value;
    }
}

double from_param(const OpenSfmScale& scale, Unit unit, double param) {
    switch (unit) {
        case Unit::size:
            return param / scale.size;
        case Unit::center_x:
            return (param - scale.center_x) / scale.size;
        case Unit::center_y:
            return (param - scale.center_y) / scale.size;
        default:
            return param;
    }
}

// The parameters of a camera with all members 0.
Camera empty_camera(const ProjectionType& type, const OpenSfmScale& scale) {
    Camera camera;
    camera.model = type.model;
    camera.params[type.center] = scale.center_x;
    camera.params[type.center + 1] = scale.center_y;
    return camera;
}

uint32_t constant_params(const ProjectionType& type) {
    uint32_t constant = (1u << camera_models[type.model].num_params) - 1;
    for (const Member& member : type.members) constant &= ~(1u << member.param);
    return constant;
}

// Whether what the type has no members for is as the type means it.
bool holds(const ProjectionType& type, const OpenSfmScale& scale, const Camera& camera) {
    if (camera.model != type.model) return false;
    const Camera empty = empty_camera(type, scale);
    const uint32_t constant = constant_params(type);
    for (int k = 0; k < camera.num_params(); ++k)
        if (constant >> k & 1 && camera.params[k] != empty.params[k]) return false;
    return true;
}

// The camera in the model of one of the projection types, or nothing.
std::optional<Camera> converted(const Camera& camera, const ProjectionType& type) {
    if (camera.model == type.model) return camera;
    const auto& p = camera.params;
    if (camera.model == camera_simple_radial_fisheye && type.model == camera_radial_fisheye)
        return Camera{camera_radial_fisheye, {p[0], p[1], p[2], p[3], 0}};
    if (type.model == camera_opencv_fisheye &&
        (camera.model == camera_simple_radial_fisheye || camera.model == camera_radial_fisheye))
        return Camera{
            camera_opencv_fisheye,
            {p[0], p[0], p[1], p[2], p[3], camera.model == camera_radial_fisheye ? p[4] : 0, 0, 0}};
    const std::optional<BrownForm> form = brown_form(camera);
    if (!form) return std::nullopt;
    if (type.model == camera_radial && form->fx == form->fy && form->p1 == 0 && form->p2 == 0 &&
        form->k3 == 0)
        return Camera{camera_radial, {form->fx, form->cx, form->cy, form->k1, form->k2}};
    if (type.model == camera_opencv && form->k3 == 0)
        return Camera{
            camera_opencv,
            {form->fx, form->fy, form->cx, form->cy, form->k1, form->k2, form->p1, form->p2}};
    if (type.model == camera_full_opencv)
        return Camera{camera_full_opencv,
                      {form->fx, form->fy, form->cx, form->cy, form->k1, form->k2, form->p1,
                       form->p2, form->k3}};
    return std::nullopt;
}

void set_members(Json& json, const ProjectionType& type, const OpenSfmScale& scale,
                 const Camera& camera) {
    for (const Member& member : type.members) {
        const double param = camera.params[member.param];
        if (json.contains(member.name) && json[member.name].is_number() &&
            to_param(scale, member.unit, json[member.name].get<double>()) == param)
            continue;
        if (!json.contains(member.name) && member.is_optional &&
            to_param(scale, member.unit, 0) == param && json.contains("projection_type"))
            continue;
        set_member(json, member.name, from_param(scale, member.unit, param));
    }
}

}  // namespace

OpenSfmCamera read_opensfm_camera(const JsonPlace& place) {
    std::string name = "perspective";
    if (place.find("projection_type")) name = place["projection_type"].string();
    const ProjectionType* const type = type_named(name);
    if (!type) {
        std::string known;
        for (const ProjectionType& each : projection_types())
            known += (known.empty() ? "" : ", ") + std::string(each.name);
        place.fail_here("has the projection_type '", shown(name), "', but only ", known,
                        " can be read");
    }
    constexpr int64_t most_pixels = 1 << 30;
    OpenSfmCamera read;
    read.info.width = static_cast<uint64_t>(place["width"].integer(1, most_pixels));
    read.info.height = static_cast<uint64_t>(place["height"].integer(1, most_pixels));
    const OpenSfmScale scale(read.info.width, read.info.height);
    read.camera = empty_camera(*type, scale);
    read.constant = constant_params(*type);
    for (const Member& member : type->members) {
        if (member.is_optional && !place.find(member.name)) continue;
        const double param = to_param(scale, member.unit, place[member.name].number());
        if (!std::isfinite(param)) place[member.name].fail_here("is too large");
        read.camera.params[member.param] = param;
    }
    return read;
}

void set_opensfm_camera(Json& json, const Camera& camera, const CameraInfo& info, int32_t index) {
    require(info.width > 0 && info.height > 0, "the size in pixels of cameras[", index,
            "] is not known, but OpenSfM's coordinates are shares of it; write another format");
    const OpenSfmScale scale(info.width, info.height);
    if (const ProjectionType* const type =
            json.contains("width")
                ? type_named(json.value("projection_type", std::string("perspective")))
                : nullptr;
        type && holds(*type, scale, camera)) {
        set_members(json, *type, scale, camera);
        return;
    }
    for (const ProjectionType& type : projection_types()) {
        const std::optional<Camera> other = converted(camera, type);
        if (!other || !holds(type, scale, *other)) continue;
        json = Json::object();
        set_member(json, "projection_type", type.name);
        set_member(json, "width", info.width);
        set_member(json, "height", info.height);
        for (const Member& member : type.members)
            set_member(json, member.name,
                       from_param(scale, member.unit, other->params[member.param]));
        return;
    }
    fail(Status::invalid_argument, "cameras[", index, "] is a ", camera_models[camera.model].name,
         " camera with parameters that no projection type of OpenSfM has; write another format");
}

}  // namespace clba
