// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <vector>

#include "linear/device_problem.hpp"
#include "linear/stored_jacobian.hpp"

namespace clba {

enum class Damping : int { marquardt = 1, levenberg = 2, uncertainty = 3 };  // clba.h

struct DampingOptions {
    Damping policy = Damping::marquardt;
    double min_diagonal = 1e-6;
    double max_diagonal = 1e32;
};

// (J^T J + lambda D^2) delta = -gradient at the current state: the Jacobian, its gradient, the
// diagonal blocks U and V, the damping, and factored inverses of damped blocks.
class NormalEquations {
public:
    NormalEquations(DeviceProblem& problem, const DampingOptions& damping);

    DeviceProblem& problem() { return problem_; }
    StoredJacobian jacobian;
    Vector gradient;  // filled with the Jacobian by the evaluator

    // U, V and D^2 of the Jacobian. To be called after each linearisation.
    void update_blocks();
    const Buffer& u() const { return u_; }
    const std::vector<Buffer>& v() const { return v_; }
    const Vector& damping() const { return d2_; }  // D^2

    // Inverse factors of blocks + lambda D^2; return how many are not positive definite.
    int64_t factor_points(double lambda);
    int64_t factor_images(double lambda, const Buffer& matrices);
    const std::vector<Buffer>& point_factors() const { return point_factors_; }
    const Buffer& image_factors() const { return image_factors_; }
    // z = G^T G r.
    void apply_image_factors(const Vector& r, Vector& z);
    void apply_point_factors(const Vector& r, Vector& z);

private:
    Kernel& kernel(const char* name);
    int64_t num_groups(int64_t n) const;
    int64_t read_failures(int64_t groups);

    DeviceProblem& problem_;
    Queue& queue_;
    DampingOptions options_;
    std::string defines_;
    bool is_first_ = true;
    Buffer u_;
    std::vector<Buffer> v_;
    Vector d2_;
    Vector initial_diagonal_;  // levenberg alone
    Buffer image_factors_;
    std::vector<Buffer> point_factors_;
    Buffer failures_;
};

}  // namespace clba
