// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "covariance/gauge.hpp"

namespace clba {

// The change of a solution dx, known up to N c, to the one with C^T dx = 0 (Baarda's
// S-transformation): dx - N M C^T dx with M = (C^T N)^-1, N the problem's free similarities.
class GaugeTransform {
public:
    GaugeTransform(const Problem& problem, const ParameterLayout& layout,
                   const Similarities& similarities, const Freedoms& freedoms,
                   Constraints constraints, const GaugeChoice& choice);

    const Constraints& constraints() const { return constraints_; }
    int num_freedoms() const { return constraints_.num(); }
    const Eigen::MatrixXd& inverse() const { return inverse_; }  // M
    // Rows of N.
    const Eigen::MatrixXd& of_f() const { return of_f_; }
    Eigen::Matrix<double, 3, Eigen::Dynamic> of_point(int32_t point) const;
    int32_t held_image() const { return held_image_; }  // whose pose the gauge holds, -1: none

private:
    const Problem& problem_;
    const Similarities& similarities_;
    Freedoms freedoms_;
    Constraints constraints_;
    Eigen::MatrixXd of_f_, inverse_;
    int32_t held_image_ = -1;
};

// N of the F side: rows of constants and of intrinsics are 0.
Eigen::MatrixXd f_tangents(const Problem& problem, const ParameterLayout& layout,
                           const Similarities& similarities, const Freedoms& freedoms);

}  // namespace clba
