// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "problem/problem.hpp"

// OpenMVG's types of intrinsics as cameras.
namespace clba::openmvg {

enum class Type { pinhole, radial_k1, radial_k3, brown_t2, fisheye };
struct TypeRow {
    const char* name;
    const char* distortion;  // the member that holds it, or null
    size_t num_distortion;
};
const TypeRow& row_of(Type type);
std::optional<Type> type_of(std::string_view name);

// An intrinsic's numbers; distortion in the order of the widest type, k1, k2, k3, t1, t2, or of
// fisheye, k1 to k4.
struct Intrinsic {
    Type type;
    double focal_length;
    std::array<double, 2> center;
    std::array<double, 5> distortion{};
};

Camera camera_of(const Intrinsic& intrinsic);

// Bits of parameters that the intrinsic does not have, or that would part from each other.
uint32_t constant_params(const Intrinsic& intrinsic, const Camera& camera);

// As the type that the camera's model is closest to; nothing if there is none.
std::optional<Intrinsic> intrinsic_of(const Camera& camera);

// Whether the numbers have a place in the type.
bool holds(Type type, const Intrinsic& intrinsic);

}  // namespace clba::openmvg
