// SPDX-License-Identifier: Apache-2.0
#include "io/openmvg_intrinsics.hpp"

#include <iterator>

#include "io/camera_forms.hpp"

namespace clba::openmvg {
namespace {

constexpr TypeRow types[] = {{"pinhole", nullptr, 0},
                             {"pinhole_radial_k1", "disto_k1", 1},
                             {"pinhole_radial_k3", "disto_k3", 3},
                             {"pinhole_brown_t2", "disto_t2", 5},
                             {"fisheye", "fisheye", 4}};

}  // namespace

const TypeRow& row_of(Type type) {
    return types[static_cast<size_t>(type)];
}

std::optional<Type> type_of(std::string_view name) {
    for (size_t i = 0; i < std::size(types); ++i)
        if (types[i].name == name) return static_cast<Type>(i);
    return std::nullopt;
}

Camera camera_of(const Intrinsic& intrinsic) {
    const double f = intrinsic.focal_length;
    const auto& c = intrinsic.center;
    const auto& k = intrinsic.distortion;
    switch (intrinsic.type) {
        case Type::pinhole:
            return {camera_simple_pinhole, {f, c[0], c[1]}};
        case Type::radial_k1:
            return {camera_simple_radial, {f, c[0], c[1], k[0]}};
        case Type::fisheye:
            if (k[2] == 0 && k[3] == 0) return {camera_radial_fisheye, {f, c[0], c[1], k[0], k[1]}};
            return {camera_opencv_fisheye, {f, f, c[0], c[1], k[0], k[1], k[2], k[3]}};
        default:
            return {camera_brown, {f, c[0], c[1], k[0], k[1], k[2], k[3], k[4]}};
    }
}

uint32_t constant_params(const Intrinsic& intrinsic, const Camera& camera) {
    if (intrinsic.type == Type::radial_k3) return 0b11000000;
    return camera.model == camera_opencv_fisheye ? 0b11 : 0;
}

std::optional<Intrinsic> intrinsic_of(const Camera& camera) {
    const auto& p = camera.params;
    switch (camera.model) {
        case camera_simple_radial_fisheye:
            return Intrinsic{Type::fisheye, p[0], {p[1], p[2]}, {p[3]}};
        case camera_radial_fisheye:
            return Intrinsic{Type::fisheye, p[0], {p[1], p[2]}, {p[3], p[4]}};
        case camera_opencv_fisheye:
            if (p[0] != p[1]) return std::nullopt;
            return Intrinsic{Type::fisheye, p[0], {p[2], p[3]}, {p[4], p[5], p[6], p[7]}};
        default:
            break;
    }
    const std::optional<BrownForm> form = brown_form(camera);
    if (!form || form->fx != form->fy) return std::nullopt;
    Intrinsic intrinsic{Type::brown_t2,
                        form->fx,
                        {form->cx, form->cy},
                        {form->k1, form->k2, form->k3, form->p1, form->p2}};
    if (camera.model == camera_simple_pinhole || camera.model == camera_pinhole)
        intrinsic.type = Type::pinhole;
    else if (camera.model == camera_simple_radial)
        intrinsic.type = Type::radial_k1;
    else if (form->p1 == 0 && form->p2 == 0)
        intrinsic.type = Type::radial_k3;
    return intrinsic;
}

bool holds(Type type, const Intrinsic& intrinsic) {
    if ((type == Type::fisheye) != (intrinsic.type == Type::fisheye)) return false;
    for (size_t k = row_of(type).num_distortion; k < intrinsic.distortion.size(); ++k)
        if (intrinsic.distortion[k] != 0) return false;
    return true;
}

}  // namespace clba::openmvg
