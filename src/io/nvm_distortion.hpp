// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <optional>

namespace clba {

// With u the undistorted radius and d the distorted one in units of f, u = d (1 + r d^2) is what
// VisualSFM has and d = u (1 + k u^2) is simple_radial. The k of least squares over radii up to
// that of the outermost measurement.
double radial_from_measured(double r, double largest_d);

// The r that is read as this k, to rounding, by the secant method; nothing if there is none near
// -k.
std::optional<double> measured_from_radial(double k, double largest_d);

// The largest |d - u (1 + k u^2)| with u = d (1 + r d^2).
double distortion_difference(double r, double k, double largest_d);

}  // namespace clba
