// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"

namespace clba {

// The tangent of an image's pose, then its intrinsics, as a linear function of F scalars: of its
// own block, of a camera's, and in rigs of those of its frame and its sensor.
class ImageTangent {
public:
    ImageTangent(const Problem& problem, const ParameterLayout& layout, int32_t image);

    struct Part {
        int32_t block;           // of ParameterLayout::blocks
        int32_t offset;          // of its first scalar
        Eigen::MatrixXd matrix;  // columns of constants are there too
    };
    const std::vector<Part>& parts() const { return parts_; }

    // Of rows of the F side.
    template <class Rows>
    Eigen::MatrixXd operator()(const Rows& rows) const {
        Eigen::MatrixXd result = Eigen::MatrixXd::Zero(size_, rows.cols());
        for (const Part& part : parts_)
            result += part.matrix * rows.middleRows(part.offset, part.matrix.cols());
        return result;
    }
    // Adds the gradient of `weights` times the pose (6 rows) to rows of the F side, constants left
    // out.
    void add_pose_functional(const ParameterLayout& layout, const Eigen::MatrixXd& weights,
                             Eigen::MatrixXd& rows) const;

private:
    int32_t size_;
    std::vector<Part> parts_;
};

}  // namespace clba
