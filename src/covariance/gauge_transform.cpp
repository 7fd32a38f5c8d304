// SPDX-License-Identifier: Apache-2.0
#include "covariance/gauge_transform.hpp"

#include <Eigen/LU>
#include <utility>

#include "base/error.hpp"

namespace clba {

Eigen::MatrixXd f_tangents(const Problem& problem, const ParameterLayout& layout,
                           const Similarities& similarities, const Freedoms& freedoms) {
    Eigen::MatrixXd tangents = Eigen::MatrixXd::Zero(layout.num_f, freedoms.cols());
    for (const ParameterBlock& block : layout.blocks) {
        if (!block.has_pose()) continue;
        tangents.middleRows<num_pose_params>(block.offset) =
            similarities.of_block(problem, block) * freedoms;
        for (int32_t k = block.offset; k < block.offset + num_pose_params; ++k)
            if (!(layout.scale[k] > 0)) tangents.row(k).setZero();
    }
    return tangents;
}

GaugeTransform::GaugeTransform(const Problem& problem, const ParameterLayout& layout,
                               const Similarities& similarities, const Freedoms& freedoms,
                               Constraints constraints, const GaugeChoice& choice)
    : problem_(problem),
      similarities_(similarities),
      freedoms_(freedoms),
      constraints_(std::move(constraints)),
      of_f_(f_tangents(problem, layout, similarities, freedoms)) {
    if (num_freedoms() == 0) return;
    Eigen::MatrixXd held = constraints_.f.transpose() * of_f_;
    for (const auto& [point, c] : constraints_.points) held += c.transpose() * of_point(point);
    const Eigen::FullPivLU<Eigen::MatrixXd> lu(held);
    require(lu.rcond() > 1e-8, "gauge = ", gauge_name(choice.gauge),
            " does not hold all freedoms of a similarity here: what it holds lies on a line or "
            "falls together; choose another gauge, or other images or points");
    inverse_ = lu.inverse();
    if (choice.gauge == Gauge::first_image_and_baseline) held_image_ = choice.images[0];
}

Eigen::Matrix<double, 3, Eigen::Dynamic> GaugeTransform::of_point(int32_t point) const {
    if (!(point_scale(problem_, point)[0] > 0))
        return Eigen::Matrix<double, 3, Eigen::Dynamic>::Zero(3, freedoms_.cols());
    return similarities_.of_position(problem_.points[point]) * freedoms_;
}

}  // namespace clba
