// SPDX-License-Identifier: Apache-2.0
#include "io/camera_forms.hpp"

#include <cmath>

namespace clba {

std::optional<BrownForm> brown_form(const Camera& camera) {
    const auto& p = camera.params;
    switch (camera.model) {
        case camera_simple_pinhole:
            return BrownForm{p[0], p[0], p[1], p[2]};
        case camera_pinhole:
            return BrownForm{p[0], p[1], p[2], p[3]};
        case camera_simple_radial:
            return BrownForm{p[0], p[0], p[1], p[2], p[3]};
        case camera_radial:
            return BrownForm{p[0], p[0], p[1], p[2], p[3], p[4]};
        case camera_opencv:
            return BrownForm{p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]};
        case camera_full_opencv:
            if (p[9] != 0 || p[10] != 0 || p[11] != 0) return std::nullopt;
            return BrownForm{p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]};
        case camera_brown:
            return BrownForm{p[0], p[0], p[1], p[2], p[3], p[4], p[6], p[7], p[5]};
        default:
            return std::nullopt;
    }
}

bool is_rotation(const std::array<double, 9>& m) {
    constexpr double tolerance = 1e-3;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j <= i; ++j) {
            double sum = i == j ? -1 : 0;
            for (int k = 0; k < 3; ++k) sum += m[3 * i + k] * m[3 * j + k];
            if (!(std::abs(sum) <= tolerance)) return false;
        }
    return m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
               m[2] * (m[3] * m[7] - m[4] * m[6]) >
           0;
}

std::array<double, 3> rotated(const std::array<double, 9>& m, const std::array<double, 3>& v) {
    return {m[0] * v[0] + m[1] * v[1] + m[2] * v[2], m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
            m[6] * v[0] + m[7] * v[1] + m[8] * v[2]};
}

std::array<double, 3> translation_from_center(const std::array<double, 4>& rotation,
                                              const std::array<double, 3>& center) {
    const std::array<double, 3> t = rotated(rotation_matrix(rotation), center);
    return {-t[0], -t[1], -t[2]};
}

}  // namespace clba
