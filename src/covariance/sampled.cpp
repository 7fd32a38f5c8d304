// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Dense>
#include <cmath>

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "covariance/estimates.hpp"
#include "covariance/image_tangent.hpp"
#include "linear/pcg_solvers.hpp"

namespace clba {
namespace {

using Eigen::VectorXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

uint64_t mixed(uint64_t x) {  // splitmix64's finaliser
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

// Two standard normal numbers that depend on the arguments alone (Box and Muller).
std::array<double, 2> normals(uint64_t stream, int64_t index) {
    const uint64_t first = mixed(stream + 2 * static_cast<uint64_t>(index));
    const uint64_t second = mixed(stream + 2 * static_cast<uint64_t>(index) + 1);
    const auto uniform = [](uint64_t x) { return (static_cast<double>(x >> 11) + 0.5) * 0x1p-53; };
    const double radius = std::sqrt(-2 * std::log(uniform(first)));
    const double angle = 2 * 3.14159265358979323846 * uniform(second);
    return {radius * std::cos(angle), radius * std::sin(angle)};
}

LinearSolverOptions solver_options(const CovarianceOptions& options) {
    LinearSolverOptions solver;
    solver.max_iterations = options.max_linear_solver_iterations;
    // Every mode of a sample adds about as much to the quadratic model, those of small eigenvalues
    // and large variance too: with n modes one is there to 1e-4 when the model is to 1e-4 / n.
    solver.eta = 1e-10;
    return solver;
}

class SampledCovariances {
public:
    SampledCovariances(const UndampedSystem& system, const CovarianceOptions& options,
                       Covariance& covariance)
        : system_(system),
          layout_(system.device.layout()),
          max_iterations_(options.max_linear_solver_iterations),
          seed_(options.seed),
          solver_(solver_options(options), system.equations),
          covariance_(covariance) {
        DeviceProblem& device = system.device;
        noise_ = device.make_vector("a sample");
        zero_ = device.make_reduced_vector("a sample");
        right_side_ = device.make_reduced_vector("a sample");
        step_ = device.make_reduced_vector("a sample");
        f_.resize(layout_.num_f);
        e_.resize(static_cast<size_t>(3) * system.problem.points.size());
    }

    void find() {
        const int64_t failures = solver_.factor_preconditioner(0);
        int64_t num_empty = 0;
        for (const ParameterBlock& block : layout_.blocks) num_empty += is_empty(block) ? 1 : 0;
        require(failures <= num_empty, failures - num_empty,
                " blocks of poses or intrinsics are not determined by their observations; hold "
                "them constant, or remove them");
        for (int32_t sample = 0; sample < covariance_.num_samples; ++sample) {
            draw(sample);
            take_gauge_away();
            add();
        }
        const auto finish = [&](std::vector<double>& values) {
            for (double& value : values) value /= covariance_.num_samples;
        };
        finish(covariance_.images);
        finish(covariance_.cameras);
        finish(covariance_.point_values);
    }

private:
    bool is_empty(const ParameterBlock& block) const {
        bool any_free = false, any_observed = false;
        for (int32_t k = block.offset; k < block.offset + block.size; ++k) {
            any_free = any_free || layout_.scale[k] > 0;
            any_observed = any_observed || (layout_.scale[k] > 0 && system_.is_observed[k]);
        }
        return any_free && !any_observed;
    }

    // H^-1 J^T e into f_ and e_.
    void draw(int32_t sample) {
        DeviceProblem& device = system_.device;
        Jacobian& jacobian = system_.equations.jacobian;
        VectorOperations& vectors = device.vectors();
        const uint64_t stream = mixed(mixed(seed_) + static_cast<uint64_t>(sample));
        device.fill_slots<double>(jacobian.product(), Jacobian::num_product_rows,
                                  [&](int64_t observation, int, auto&& slot) {
                                      const auto e = normals(stream, observation);
                                      slot(0) = e[0];
                                      slot(1) = e[1];
                                  });
        noise_.fill_zero();
        jacobian.add_transposed(noise_);
        jacobian.eliminate(zero_, noise_.e, system_.equations.point_factors(), right_side_);
        vectors.scale_and_add(1.0, noise_, 1.0, right_side_);
        vectors.mask_constants(device.scale_f, right_side_.f);
        const PcgResult result = solver_.solve_system(0, right_side_, step_);
        covariance_.num_linear_solver_iterations += result.num_iterations;
        require(result.is_usable && result.num_iterations < max_iterations_,
                "conjugate gradients did not end within max_linear_solver_iterations = ",
                max_iterations_, "; allow more, or the exact method more memory");
        std::vector<double> f(static_cast<size_t>(layout_.num_f));
        device.read_wide(step_.f, f, f.size());
        f_ = Eigen::Map<const VectorXd>(f.data(), layout_.num_f);
        if (covariance_.points.empty() && system_.gauge.constraints().points.empty()) return;
        // V^-1 (J_E^T e - W^T f).
        for (Buffer& part : noise_.e) negate(part);
        jacobian.back_substitute(step_, noise_.e, system_.equations.point_factors());
        for (size_t c = 0; c < device.chunks().size(); ++c) {
            const std::vector<int32_t>& slot_point = device.tiles().chunks[c].slot_point;
            const auto n = static_cast<int64_t>(slot_point.size());
            const auto rows = jacobian.point_step()[c].map_read<double>();
            for (int64_t slot = 0; slot < n; ++slot)
                for (int k = 0; k < 3 && slot_point[slot] >= 0; ++k)
                    e_[3 * static_cast<size_t>(slot_point[slot]) + static_cast<size_t>(k)] =
                        rows[k * n + slot];
        }
    }

    static void negate(Buffer& buffer) {
        const auto values = buffer.map_update<double>();
        const auto n = static_cast<int64_t>(buffer.bytes() / sizeof(double));
        for (int64_t i = 0; i < n; ++i) values[i] = -values[i];
    }

    Eigen::Map<Eigen::Vector3d> of_point(int32_t point) {
        return Eigen::Map<Eigen::Vector3d>(e_.data() + 3 * int64_t{point});
    }

    void take_gauge_away() {
        const GaugeTransform& gauge = system_.gauge;
        if (gauge.num_freedoms() == 0) return;
        VectorXd held = gauge.constraints().f.transpose() * f_;
        for (const auto& [point, c] : gauge.constraints().points)
            held += c.transpose() * of_point(point);
        const VectorXd move = gauge.inverse() * held;
        f_ -= gauge.of_f() * move;
        for (const int32_t point : covariance_.points)
            of_point(point) -= gauge.of_point(point) * move;
    }

    void add() {
        const auto add_square = [](const auto& x, double* values) {
            Eigen::Map<RowMajor>(values, x.size(), x.size()) += x * x.transpose();
        };
        const Problem& problem = system_.problem;
        for (int32_t i = 0; i < problem.num_images(); ++i) {
            VectorXd x(covariance_.image_size[i]);
            if (layout_.is_composed(i)) {
                x = ImageTangent(problem, layout_, i)(f_);
            } else {
                const int32_t n = covariance_.image_size[i] - num_pose_params;
                x.head<num_pose_params>() = f_.segment<num_pose_params>(layout_.pose_offset[i]);
                x.tail(n) = f_.segment(layout_.intrinsics_offset[problem.images[i].camera], n);
            }
            add_square(x, covariance_.images.data() + covariance_.image_begin[i]);
        }
        for (int32_t c = 0; c < problem.num_cameras(); ++c)
            add_square(
                VectorXd(f_.segment(layout_.intrinsics_offset[c], covariance_.camera_size[c])),
                covariance_.cameras.data() + covariance_.camera_begin[c]);
        parallel_ranges(static_cast<int64_t>(covariance_.points.size()), 4096,
                        [&](int64_t begin, int64_t end) {
                            for (int64_t p = begin; p < end; ++p)
                                add_square(Eigen::Vector3d(of_point(covariance_.points[p])),
                                           covariance_.point_values.data() + 9 * p);
                        });
    }

    const UndampedSystem& system_;
    const ParameterLayout& layout_;
    int32_t max_iterations_;
    uint64_t seed_;
    PcgSchur solver_;
    Covariance& covariance_;
    Vector noise_, zero_, right_side_, step_;
    VectorXd f_;
    std::vector<double> e_;
};

}  // namespace

void sample_covariances(const UndampedSystem& system, const CovarianceOptions& options,
                        Covariance& covariance) {
    SampledCovariances(system, options, covariance).find();
}

}  // namespace clba
