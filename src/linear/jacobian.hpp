// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

#include "linear/device_problem.hpp"
#include "problem/loss.hpp"

namespace clba {

// What the device keeps of the Jacobian: u, v and scale of each observation, from which its blocks
// are computed again in each product, or the blocks themselves (kernels/jacobian_layout.clh).
enum class JacobianForm : int { recomputed = 1, stored = 2 };

// Where the step of the points leads that belongs to a step of the images.
struct BackSubstitution {
    double squared_norm = 0;         // |J step|^2
    double slope = 0;                // of the points: their gradient times their step
    double squared_point_steps = 0;  // |step of the points|^2
};

// The Jacobian J = [J_F, J_E] of the current state on the device, and its products. With rigs J_F
// is that of images times T (rig_tangents.hpp), and rows() are those of images.
class Jacobian {
public:
    Jacobian(DeviceProblem& problem, JacobianForm form, const Loss& loss);

    // What the kernel `linearize` fills: one buffer a segment, rows of REAL over its slots.
    std::vector<Buffer>& rows() { return rows_; }
    // Options of programs that read or write the rows of a segment.
    const std::string& defines(size_t segment) const { return programs_[segment].rows; }

    // The blocks of every observation: 2 C + 6 rows of REAL over the slots of each segment.
    std::vector<Buffer> blocks();
    static int num_block_rows(const CameraModel& model) {
        return 2 * (num_pose_params + model.num_params) + 6;
    }
    static int num_product_rows(const CameraModel&) { return 2; }
    int num_view_rows(const CameraModel& model, bool has_whitening) const {
        return 3 + (has_whitening ? 3 : has_loss_ ? 1 : 0) + model.num_kept;
    }

    // y = J x, into slots of 2 rows of REAL a segment: product().
    void multiply(const Vector& x);
    std::vector<Buffer>& product();
    // |J x|^2.
    double squared_norm(const Vector& x);
    // x += J^T y with y = product().
    void add_transposed(Vector& x);

    // y += (J_F^T J_F - W V^-1 W^T) x on the F side, V^-1 = G^T G by point_factors.
    void add_schur_product(const Vector& x, const std::vector<Buffer>& point_factors, Vector& y);
    // y = -W V^-1 g of the points' g: 3 rows of REAL a chunk. zero: an F vector of zeros.
    void eliminate(const Vector& zero, const std::vector<Buffer>& point_gradient,
                   const std::vector<Buffer>& point_factors, Vector& y);
    // problem.trial.points = problem.state.points - V^-1 (g + W^T step).
    BackSubstitution back_substitute(const Vector& step, const std::vector<Buffer>& point_gradient,
                                     const std::vector<Buffer>& point_factors);

    // The step of the points that back_substitute found, or the E side that multiply was given: 3
    // rows of REAL a chunk, until the next product.
    const std::vector<Buffer>& point_step() const { return point_real_; }

    // U as packed lower triangles at matrix_offset.
    void image_blocks(Buffer& u);
    // Diagonal blocks of U - W V^-1 W^T (for shared cameras and repeated pairs an approximation:
    // reference/bundle.hpp, schur_diagonal_blocks).
    void schur_blocks(const std::vector<Buffer>& point_factors, Buffer& blocks);

    // Sums of a chunk's runs, which reduce_runs adds to an F vector: REALs, as many a run as its
    // segment has columns, or WIDEs, twice as many, of which the second half if is_second.
    Buffer& run_sums() { return run_sums_; }
    void reduce_runs(Step step, const DeviceChunk& chunk, Buffer& f);
    void reduce_wide_runs(const DeviceChunk& chunk, bool is_second, Buffer& f);

private:
    template <class Visit>
    void for_each_segment(Visit&& visit);
    const Buffer& of_images(const Buffer& f);
    template <class Add>
    void add_of_images(Buffer& f, Add&& add);
    template <class Launch, class Finish>
    void launch_in_stages(Launch&& launch, Finish&& finish);
    void schur_stages(int stages, const Vector& x, const std::vector<Buffer>& point_factors,
                      Vector& y);
    void sum_image_blocks(const std::vector<Buffer>* point_factors, Buffer& matrices);

    // Options of programs for a segment.
    struct Programs {
        std::string rows, run_blocks;
    };
    Programs programs_of(const DeviceSegment& segment) const;
    void reduce(Step step, const DeviceChunk& chunk, const std::string& options, int part,
                Buffer& f);

    DeviceProblem& problem_;
    Queue& queue_;
    JacobianForm form_;
    bool has_loss_;
    std::string sums_options_, wide_sums_options_;  // of reduce_runs
    std::vector<Programs> programs_;                // of the segments of all chunks
    std::vector<Buffer> rows_;
    std::vector<Buffer> product_;     // made when it is first asked for
    std::vector<Buffer> point_real_;  // 3 rows of REAL a chunk
    Buffer run_sums_;                 // of one chunk at a time
    Buffer tile_sums_;
    std::vector<double> host_sums_;
};

}  // namespace clba
