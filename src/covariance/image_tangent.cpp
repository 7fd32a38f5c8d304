// SPDX-License-Identifier: Apache-2.0
#include "covariance/image_tangent.hpp"

#include <utility>

namespace clba {

ImageTangent::ImageTangent(const Problem& problem, const ParameterLayout& layout, int32_t image)
    : size_(num_pose_params + problem.cameras[problem.images[image].camera].num_params()) {
    ImagePart parts[ParameterLayout::max_image_parts];
    const int count = layout.parts_of(image, problem.images[image].camera, parts);
    for (int k = 0; k < count; ++k) {
        Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(size_, parts[k].size);
        matrix.middleRows(parts[k].first_column, parts[k].size).setIdentity();
        if (parts[k].is_of_frame)
            matrix.topRows<num_pose_params>() =
                Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(
                    frame_tangent(problem.rigs.sensors[layout.image_sensor[image]]).data());
        parts_.push_back({parts[k].block, layout.blocks[parts[k].block].offset, std::move(matrix)});
    }
}

void ImageTangent::add_pose_functional(const ParameterLayout& layout,
                                       const Eigen::MatrixXd& weights,
                                       Eigen::MatrixXd& rows) const {
    for (const Part& part : parts_) {
        const Eigen::MatrixXd of_part =
            part.matrix.topRows<num_pose_params>().transpose() * weights;
        for (Eigen::Index k = 0; k < of_part.rows(); ++k)
            if (layout.scale[part.offset + k] > 0) rows.row(part.offset + k) += of_part.row(k);
    }
}

}  // namespace clba
