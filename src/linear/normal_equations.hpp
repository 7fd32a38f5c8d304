// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

#include "linear/device_problem.hpp"
#include "linear/jacobian.hpp"

namespace clba {

enum class Damping : int { marquardt = 1, levenberg = 2, uncertainty = 3 };  // clba.h

struct DampingOptions {
    Damping policy = Damping::marquardt;
    double min_diagonal = 1e-6;
    double max_diagonal = 1e32;
};

// (H + lambda D^2) delta = -gradient at the current state, with H = J^T J and what priors add to it
// (prior_terms.hpp): to U as P, to V in its roots. The evaluator fills what is public.
class NormalEquations {
public:
    NormalEquations(DeviceProblem& problem, const DampingOptions& damping, JacobianForm form,
                    const Loss& loss);

    DeviceProblem& problem() { return problem_; }
    Jacobian jacobian;
    Vector gradient;                     // F side
    std::vector<Buffer> point_gradient;  // E side: 3 rows of REAL a chunk
    // The same as WIDEs: filled by linearisations after keep_wide_gradient().
    std::vector<Buffer> wide_point_gradient;
    void keep_wide_gradient();
    Vector diagonal;                  // of U
    std::vector<Buffer> point_roots;  // L of V = L L^T: 6 rows of REAL a chunk
    Buffer tile_max;                  // of |point_gradient|, tile by tile of all chunks

    // With rigs: the diagonal from that of parameters' blocks, which needs the Jacobian.
    void take_diagonal_of_blocks();

    // Damping of the F side. To be called after each linearisation.
    void update_damping();

    double gradient_max_norm();
    const Buffer& u();                             // diagonal blocks, packed
    const Vector& damping() const { return d2_; }  // D^2 of the F side
    // D^2 of F and 3 a point, in the caller's order, where the first linearisation fixes it for all
    // that follow; else nothing.
    std::vector<double> fixed_damping();
    void set_fixed_damping(const std::vector<double>& values);  // after a linearisation
    // F and E together.
    void get_gradient(Vector& full);
    void get_damping(Vector& full);

    // Inverse factors of blocks + lambda D^2; return how many are not positive definite.
    int64_t factor_points(double lambda);
    // The same without damping, for points whose V is not positive definite too: a coordinate of
    // which elimination of those before it leaves a share of 1e-12 or less of its diagonal entry is
    // left out of G, whose row is 0. W G^T G W^T is then that of every generalised inverse of V.
    void factor_undamped_points();
    int64_t factor_image_blocks(double lambda);  // of U
    int64_t factor_schur_blocks(double lambda);  // of U - W V_lambda^-1 W^T, after factor_points
    const std::vector<Buffer>& point_factors() const { return point_factors_; }
    const Buffer& image_factors() const { return image_factors_; }
    // z = G^T G r.
    void apply_image_factors(const Vector& r, Vector& z);
    void apply_point_factors(const Vector& r, Vector& z);

private:
    Kernel& kernel(const char* name);
    int64_t launch_point_factors(double lambda, const std::string& defines);
    int64_t num_groups(int64_t n) const;
    int64_t read_failures(int64_t groups);
    void update_point_damping(std::vector<Buffer>& d2);
    int64_t factor_images(double lambda);

    DeviceProblem& problem_;
    Queue& queue_;
    DampingOptions options_;
    std::string defines_;
    bool has_wide_gradient_ = false;
    bool has_damping_ = false;  // of some linearisation
    bool has_u_ = false;        // of the current linearisation
    Buffer u_;                  // made when it is first asked for
    Vector d2_;
    std::vector<Buffer> fixed_point_damping_;  // levenberg alone: of the first linearisation
    Buffer image_factors_;                     // packed lower triangles at matrix_offset
    std::vector<Buffer> point_factors_;
    Buffer failures_;
};

}  // namespace clba
