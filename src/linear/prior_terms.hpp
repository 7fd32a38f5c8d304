// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

#include "linear/device_problem.hpp"
#include "reference/priors.hpp"

namespace clba {

// What the priors of a problem on a device add to its cost and its normal equations. Those of poses
// and intrinsics are linearised on the host, as P = J^T J over the F scalars; those of points in
// the kernel that linearises observations.
class PriorTerms {
public:
    PriorTerms(DeviceProblem& device, const Problem& problem);

    double cost(const State& state);
    // At the device's state: adds to the F side's gradient and diagonal, and fills P.
    void linearize(Vector& gradient, Vector& diagonal);

    // Values of P in the pattern of image_priors(), by the last linearisation.
    const std::vector<double>& values() const { return values_; }
    const reference::ImagePriors& image_priors() const { return image_priors_; }

    void add_image_product(const Buffer& x, Buffer& y);  // y += P x, F vectors
    // y += (the priors' part of V) x: 3 rows of WIDE a chunk.
    void add_point_product(const std::vector<Buffer>& x, std::vector<Buffer>& y);
    void add_image_blocks(Buffer& packed);  // packed lower triangles at matrix_offset
    // |J step|^2; point_step: 3 rows of REAL a chunk.
    double squared_norm(const Vector& step, const std::vector<Buffer>& point_step);

    // Of a chunk; buffers are empty if there are no priors of points.
    struct Points {
        int32_t num_priors = 0;
        Buffer slots;          // point slot of each prior in its chunk
        Buffer prior_of_slot;  // num_priors: none
        Buffer values;         // kernels/point_priors.clh
    };
    bool has_points() const { return has_points_; }
    const Points& points(size_t chunk) const { return points_[chunk]; }

private:
    Kernel& kernel(const char* name);
    int64_t num_groups(int64_t n) const;
    void upload_points(const Problem& problem);
    void read_state(const State& state);
    void list_block_targets();
    // launch(points, chunk, groups, first partial) for each chunk; the sum of their partials.
    template <class Launch>
    double sum_points(Launch&& launch);

    DeviceProblem& device_;
    Queue& queue_;
    std::string defines_;
    bool has_points_;
    std::vector<Points> points_;
    reference::ImagePriors image_priors_;
    std::vector<Image> images_;  // as read_state leaves them
    std::vector<Camera> cameras_;
    std::vector<Pose> sensors_;
    std::vector<double> values_, step_, partials_;
    Buffer rows_, row_begin_, columns_, device_values_;
    Buffer block_targets_, block_sources_;  // in packed triangles, in the values of P
    int32_t num_block_values_ = 0;
    Vector sum_;  // of an upload
    Buffer device_partials_;
};

}  // namespace clba
