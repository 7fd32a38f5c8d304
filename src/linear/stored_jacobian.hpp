// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <vector>

#include "linear/device_problem.hpp"

namespace clba {

// The Jacobian of the current state, stored on the device, and its products.
class StoredJacobian {
public:
    explicit StoredJacobian(DeviceProblem& problem);

    // What the Jacobian kernel fills: one buffer a segment, 2 C + 6 rows of REAL over its slots.
    std::vector<Buffer>& blocks() { return blocks_; }
    static int num_rows(int num_columns) { return 2 * num_columns + 6; }
    static int num_product_rows(int) { return 2; }

    // y = J x, into slots of 2 rows of REAL a segment: product().
    void multiply(const Vector& x);
    std::vector<Buffer>& product() { return product_; }
    // |J x|^2.
    double squared_norm(const Vector& x);
    // x = J^T y with y = product().
    void multiply_transposed(Vector& x);
    // y = (J_F^T J_F - W V^-1 W^T) x on the F side, V^-1 = G^T G by point_factors.
    void schur_multiply(const Vector& x, const std::vector<Buffer>& point_factors, Vector& y);

    // Diagonal blocks: U as packed lower triangles at matrix_offset, V as 6 rows a chunk.
    void image_blocks(Buffer& u);
    void point_blocks(std::vector<Buffer>& v);
    // Diagonal blocks of U - W V^-1 W^T (for shared cameras and repeated pairs an approximation:
    // reference/bundle.hpp, schur_diagonal_blocks).
    void schur_blocks(const std::vector<Buffer>& point_factors, Buffer& blocks);

    // F vector += the sums that the runs of a segment left in run_sums: REAL, or double if
    // is_double.
    void reduce_runs(Step step, const DeviceSegment& segment, const Buffer& run_sums,
                     bool is_double, Buffer& f);

private:
    std::string defines(int num_columns) const;
    void multiply_into(const Buffer& x_f, const std::vector<Buffer>& x_e);
    void sum_image_blocks(std::vector<Buffer>* weights, Buffer& matrices);
    template <class Visit>
    void for_each_segment(Visit&& visit);

    DeviceProblem& problem_;
    Queue& queue_;
    std::vector<Buffer> blocks_;
    std::vector<Buffer> product_;
    std::vector<Buffer> weights_;     // made when schur_blocks is first asked for
    std::vector<Buffer> point_real_;  // 3 rows of REAL a chunk
    Buffer run_sums_;                 // of one segment at a time
    Buffer run_blocks_;
};

}  // namespace clba
