// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"

// The serial double-precision twin of every kernel, in the caller's order, written for clarity. The
// twins are checked against hand numbers and central differences, the kernels against the twins.
namespace clba::reference {

struct Cost {
    double cost = 0;           // 1/2 sum rho(|r|^2)
    int64_t num_behind = 0;    // observations of points behind their camera
    int64_t num_singular = 0;  // observations in the camera's own plane (see is_singular)
};

// Residuals (2 an observation, may be nullptr): whitened and multiplied by sqrt(rho'). The cost is
// the sum of the sums of blocks of 4096 observations, each summed in order by one thread.
Cost residual(const Problem& problem, double* residuals);

// |projection - observation| without the loss, and whitened: |L^-1 (projection - observation)|.
struct ReprojectionError {
    double pixels, sigmas;
    bool is_behind, is_singular;
};
// visit(i, ReprojectionError) for observations [first, first + count), in several threads.
void visit_errors(const Problem& problem, int64_t first, int64_t count,
                  const std::function<void(int64_t, const ReprojectionError&)>& visit);

// Mean |projection - observation| of each point's observations, without covariances and loss, in
// pixels; 0 where it has none.
std::vector<double> mean_reprojection_errors(const Problem& problem);

// The Jacobian of these residuals in block compressed sparse rows: block row i is observation i.
// Columns of constant parameters are 0. Outliers are treated as Ceres' corrector does for
// rho'' <= 0: J scaled by sqrt(rho').
struct Jacobian {
    int columns = 0;             // C of an image block: 6 + intrinsics, padded with 0
    std::vector<int32_t> image;  // of each observation
    std::vector<int32_t> point;
    std::vector<double> image_blocks;  // observations x 2 x C, row-major
    std::vector<double> point_blocks;  // observations x 2 x 3, row-major
    std::vector<Pose> sensors;         // of rigs, whose images' pose columns are those of images
    int64_t num_observations() const { return static_cast<int64_t>(image.size()); }
};
Jacobian jacobian(const Problem& problem, const ParameterLayout& layout);

// y = J x: x has num_f + 3 points entries, y 2 an observation.
std::vector<double> jx(const Problem& problem, const ParameterLayout& layout,
                       const Jacobian& jacobian, const std::vector<double>& x);
// x = J^T y.
std::vector<double> jty(const Problem& problem, const ParameterLayout& layout,
                        const Jacobian& jacobian, const std::vector<double>& y);

// Diagonal blocks of J^T J: row-major size x size for each of layout.blocks, one after the other,
// then 3 x 3 a point.
struct NormalBlocks {
    std::vector<std::vector<double>> u;  // of layout.blocks
    std::vector<double> v;               // points x 9
};
NormalBlocks normal_blocks(const Problem& problem, const ParameterLayout& layout,
                           const Jacobian& jacobian);

// D^2 of each scalar (clba.h, CLBA_DAMPING_*; policy is its number), 0 where scale is 0. diagonal
// is that of J^T J, initial_diagonal the same at the first linearisation.
std::vector<double> damping_diagonal(int policy, double smallest, double largest,
                                     const std::vector<double>& scale,
                                     const std::vector<double>& diagonal,
                                     const std::vector<double>& initial_diagonal);

// Inverse Cholesky factors: for a positive definite A = L L^T of n x n (row-major), G = L^-1, so
// that A^-1 = G^T G; rows and columns with scale 0 (constant parameters) are left out of A, and 0
// in G. scale nullptr keeps all. Returns false, and leaves g all 0, if A is not positive definite
// or not finite.
bool inverse_factor(int n, const double* a, const double* scale, double* g);

// S x for the reduced camera system S = U + D_F - W V^-1 W^T, where V^-1 = G^T G with factors of 9
// numbers a point (lower triangles, row-major) and D_F the damping of each F scalar.
std::vector<double> schur_product(const Problem& problem, const ParameterLayout& layout,
                                  const Jacobian& jacobian,
                                  const std::vector<double>& point_factors,
                                  const std::vector<double>& damping_f,
                                  const std::vector<double>& x);
// sum over the observations of a block of J_F^T (I - J_E V^-1 J_E^T) J_F: the diagonal blocks of
// U - W V^-1 W^T where no image sees a point twice and no camera is shared, and otherwise a
// positive semidefinite approximation of them. Without damping.
std::vector<std::vector<double>> schur_diagonal_blocks(const Problem& problem,
                                                       const ParameterLayout& layout,
                                                       const Jacobian& jacobian,
                                                       const std::vector<double>& point_factors);

}  // namespace clba::reference
