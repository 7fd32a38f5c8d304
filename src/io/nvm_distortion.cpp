// SPDX-License-Identifier: Apache-2.0
#include "io/nvm_distortion.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace clba {
namespace {

constexpr int num_samples = 64;  // of the range of radii

}  // namespace

double radial_from_measured(double r, double largest_d) {
    double numerator = 0, denominator = 0;
    for (int i = 1; i <= num_samples; ++i) {
        const double d = largest_d * i / num_samples, u = d * (1 + r * d * d);
        numerator -= r * d * d * d * u * u * u;  // d - u is -r d^3
        denominator += u * u * u * u * u * u;
    }
    return denominator > 0 ? numerator / denominator : -r;
}

std::optional<double> measured_from_radial(double k, double largest_d) {
    const double rounding = 64 * std::numeric_limits<double>::epsilon() * std::abs(k);
    double before = 0, error_before = -k, r = -k, error = 0;
    for (int i = 0; i < 60; ++i) {
        error = radial_from_measured(r, largest_d) - k;
        if (error == 0 || error == error_before || !std::isfinite(error)) break;
        if (std::abs(error) <= rounding && std::abs(error) >= std::abs(error_before)) break;
        const double next = r - error * (r - before) / (error - error_before);
        before = r;
        error_before = error;
        r = next;
    }
    return std::abs(error) <= rounding ? std::optional(r) : std::nullopt;
}

double distortion_difference(double r, double k, double largest_d) {
    double most = 0;
    for (int i = 1; i <= num_samples; ++i) {
        const double d = largest_d * i / num_samples, u = d * (1 + r * d * d);
        most = std::max(most, std::abs(d - u * (1 + k * u * u)));
    }
    return most;
}

}  // namespace clba
