// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <optional>

#include "problem/problem.hpp"

namespace clba {

// Camera models in the terms of the widest that is a polynomial. x = P.x / P.z
// and y = P.y / P.z are distorted by
//   x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2)
//   y (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p2 x y + p1 (r2 + 2 y^2)
// Nothing for snavely cameras (see convert.hpp) and for models with a denominator or an angle.
struct BrownForm {
    double fx = 0, fy = 0, cx = 0, cy = 0;
    double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0;
};
std::optional<BrownForm> brown_form(const Camera& camera);

// Whether each entry of matrix times its transpose is within 1e-3 of the identity's and the
// determinant is positive.
bool is_rotation(const std::array<double, 9>& matrix);

std::array<double, 3> rotated(const std::array<double, 9>& matrix, const std::array<double, 3>& v);
// -R c for the camera centre c.
std::array<double, 3> translation_from_center(const std::array<double, 4>& rotation,
                                              const std::array<double, 3>& center);

}  // namespace clba
