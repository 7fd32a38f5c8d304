// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"

namespace clba {

enum class Gauge : int {  // clba.h
    automatic = 0,
    problem = 1,
    first_image_and_baseline = 2,
    three_points = 3,
    inner = 4
};
const char* gauge_name(Gauge gauge);

// What takes the freedoms away; -1: chosen by choose_images.
struct GaugeChoice {
    Gauge gauge = Gauge::automatic;
    std::array<int32_t, 2> images{-1, -1};
    std::array<int32_t, 3> points{-1, -1, -1};
};

// What no residual of an observation notices: the world's similarities X -> X + extent tau + omega
// x (X - origin) + sigma (X - origin), as tangents with the columns tau, omega, sigma. Origin and
// extent are the mean and spread of the camera centres.
class Similarities {
public:
    explicit Similarities(const Problem& problem);
    Eigen::Matrix<double, 3, 7> of_position(const Point& position) const;
    Eigen::Matrix<double, 6, 7> of_pose(const Pose& pose) const;  // of clba.h's tangent
    // Of a block with a pose; a sensor's place in its rig is scaled.
    Eigen::Matrix<double, 6, 7> of_block(const Problem& problem, const ParameterBlock& block) const;
    double extent() const { return extent_; }

private:
    Eigen::Vector3d origin_;
    double extent_ = 0;
};

using Freedoms = Eigen::Matrix<double, 7, Eigen::Dynamic>;
// A basis of the similarities that move nothing constant.
Freedoms free_similarities(const Problem& problem, const ParameterLayout& layout,
                           const Similarities& similarities);

// Linear functionals c^T dx = 0 that take freedoms away: columns over F scalars and, for some
// points, over their coordinates. Lengths are divided by the extent.
struct Constraints {
    Eigen::MatrixXd f;
    std::vector<std::pair<int32_t, Eigen::Matrix<double, 3, Eigen::Dynamic>>> points;
    int num() const { return static_cast<int>(f.cols()); }
};

// F scalars that observations, or whatever else is in the normal equations, say something about.
using IsObserved = std::vector<char>;

// The images that are not given: the first that is observed, constant ones before others where
// constants hold some freedoms, and the one whose centre is farthest from it.
void choose_images(const Problem& problem, const ParameterLayout& layout,
                   const IsObserved& is_observed, GaugeChoice& choice);

// As many functionals as `freedoms` has columns; throws an invalid_argument error where the choice
// holds more or does not hold all of them.
Constraints make_constraints(const Problem& problem, const ParameterLayout& layout,
                             const Similarities& similarities, const Freedoms& freedoms,
                             const IsObserved& is_observed, const GaugeChoice& choice);

// Where fix_gauge puts what it holds.
struct GaugeTarget {
    Pose pose;                                    // of the first image, and
    double baseline = 0;                          // its distance from the second
    std::array<Point, 3> points{};                // of three_points
    const std::vector<Point>* centers = nullptr;  // of inner, an image each
};
// Moves the state by a similarity, which changes no residual of an observation. Refuses a problem
// with constant poses or points.
void fix_gauge(const GaugeChoice& choice, const GaugeTarget& target, Problem& problem);

}  // namespace clba
