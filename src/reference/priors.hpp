// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"

// What priors (problem/priors.hpp) add to the cost and to the normal equations, in double on the
// host.
namespace clba::reference {

// 1/2 sum |L^-1 (h(x) - target)|^2 over all priors.
double prior_cost(const Problem& problem);

// V += L^-T L^-1 of a prior; row-major or column-major 3x3.
void add_information(const PointPrior& prior, double* v);

// The priors of poses and intrinsics, whose whitened residuals r and Jacobian J make the symmetric
// matrix P = J^T J over the F scalars. Columns of constant scalars are left out of J.
class ImagePriors {
public:
    ImagePriors(const Problem& problem, const ParameterLayout& layout);

    // Compressed rows of P: those that are not empty, ascending; columns ascend in each.
    const std::vector<int32_t>& rows() const { return rows_; }
    const std::vector<int32_t>& row_begin() const { return row_begin_; }  // of each, and end
    const std::vector<int32_t>& columns() const { return columns_; }

    // The state is that of images' poses and cameras' parameters.
    double cost(const std::vector<Image>& images, const std::vector<Camera>& cameras) const;
    // J^T r (num_f numbers) and the values of P. sensors: those of rigs, if there are.
    void linearize(const std::vector<Image>& images, const std::vector<Camera>& cameras,
                   const std::vector<Pose>& sensors, std::vector<double>& gradient,
                   std::vector<double>& values) const;

    // visit(r, num_scalars, scalars, row) for each whitened residual and its row of J, whose
    // columns are `scalars`: -1 for constants. A scalar may occur twice.
    using VisitRow =
        std::function<void(double r, int num_scalars, const int32_t* scalars, const double* row)>;
    void for_each_row(const std::vector<Image>& images, const std::vector<Camera>& cameras,
                      const std::vector<Pose>& sensors, const VisitRow& visit) const;

private:
    struct Term;
    template <class Use>
    void for_each_term(Use&& use) const;
    void list_pattern();

    Priors priors_;
    std::vector<double> scale_;
    std::vector<int32_t> pose_offset_, intrinsics_offset_;
    std::vector<int32_t> image_sensor_;   // ParameterLayout::image_sensor
    std::vector<int32_t> sensor_offset_;  // of each sensor that has one
    std::vector<int32_t> num_params_;     // of each camera
    std::vector<int32_t> rows_, row_begin_, columns_;
};

}  // namespace clba::reference
