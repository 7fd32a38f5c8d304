// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cmath>

#include "api/handles.hpp"

namespace clba {

// Row i, whose numbers must be finite.
template <size_t size>
std::array<double, size> read_finite(const Rows<const double>& rows, int64_t i, const char* name) {
    std::array<double, size> values;
    for (size_t k = 0; k < size; ++k) {
        values[k] = rows.get(i, k);
        require(std::isfinite(values[k]), name, "[", i, "][", k, "] = ", values[k],
                ", but it must be finite");
    }
    return values;
}

// A pose in the format of clba_problem_set_images, whose quaternion is not normalised yet, but can
// be.
inline Pose read_pose(const Rows<const double>& rows, int64_t i, const char* name) {
    const auto values = read_finite<7>(rows, i, name);
    const Pose pose{{values[0], values[1], values[2], values[3]},
                    {values[4], values[5], values[6]}};
    double norm2 = 0;
    for (double q : pose.rotation) norm2 += q * q;
    require(norm2 > 0 && std::isfinite(norm2), name, "[", i, "] has a quaternion of squared norm ",
            norm2, ", but it must be one that can be normalised");
    return pose;
}

inline void write_pose(const Pose& pose, const Rows<double>& rows, int64_t i) {
    for (size_t k = 0; k < 4; ++k) rows.set(i, k, pose.rotation[k]);
    for (size_t k = 0; k < 3; ++k) rows.set(i, 4 + k, pose.translation[k]);
}

}  // namespace clba
