// SPDX-License-Identifier: Apache-2.0
// The baseline that the paper (Tong et al. 2013) compares itself with: Levenberg-Marquardt in one
// thread on the host, fp64, each step a direct solution of (J^T J + lambda D^2) delta = -J^T f.
//
//   paper_baseline FILE OUTPUT normal|schur MAX_ITERATIONS FUNCTION_TOLERANCE
//
// FILE and OUTPUT are BAL files. `normal` factors the whole sparse matrix, as the paper's eq. 5
// stands; `schur` eliminates the points first, as good solvers of today do. Both factor by CHOLMOD,
// through the plug-in clba_cholmod. Damping is Marquardt's, lambda follows the rule that clba uses.
// Prints JSON: the cost and the seconds since the problem was in memory after each iteration.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/error.hpp"
#include "base/stopwatch.hpp"
#include "io/bal.hpp"
#include "optimizer/trust_region.hpp"
#include "problem/parameter_layout.hpp"
#include "reference/bundle.hpp"
#include "reference/direct_schur.hpp"
#include "reference/sparse_cholesky.hpp"

namespace {

using namespace clba;
using Solve = std::function<bool(const reference::Jacobian&, const std::vector<double>& gradient,
                                 const std::vector<double>& damping, std::vector<double>& step)>;

// The lower triangle of J^T J + diag(damping), images first. Every image has a camera of its own,
// as BAL has it, so that image i's columns are `columns` ones from columns * i on.
class NormalMatrix {
public:
    NormalMatrix(const Problem& problem, const reference::Jacobian& jacobian)
        : columns_(jacobian.columns),
          num_images_(problem.num_images()),
          num_points_(problem.num_points()),
          num_f_(int64_t{num_images_} * columns_) {
        std::vector<std::vector<int32_t>> points(static_cast<size_t>(num_images_));
        for (size_t i = 0; i < jacobian.image.size(); ++i)
            points[static_cast<size_t>(jacobian.image[i])].push_back(jacobian.point[i]);
        starts_.push_back(0);
        for (int32_t image = 0; image < num_images_; ++image) {
            auto& seen = points[static_cast<size_t>(image)];
            std::sort(seen.begin(), seen.end());
            seen.erase(std::unique(seen.begin(), seen.end()), seen.end());
            for (int column = 0; column < columns_; ++column) {
                for (int row = column; row < columns_; ++row)
                    rows_.push_back(int64_t{image} * columns_ + row);
                for (const int32_t point : seen)
                    for (int k = 0; k < 3; ++k) rows_.push_back(num_f_ + 3 * int64_t{point} + k);
                starts_.push_back(static_cast<int64_t>(rows_.size()));
            }
        }
        for (int32_t point = 0; point < num_points_; ++point) {
            for (int column = 0; column < 3; ++column) {
                for (int row = column; row < 3; ++row)
                    rows_.push_back(num_f_ + 3 * int64_t{point} + row);
                starts_.push_back(static_cast<int64_t>(rows_.size()));
            }
        }
        values_.resize(rows_.size());
        for (size_t i = 0; i < jacobian.image.size(); ++i) {
            const auto& seen = points[static_cast<size_t>(jacobian.image[i])];
            const auto at = std::lower_bound(seen.begin(), seen.end(), jacobian.point[i]);
            places_.push_back(3 * (at - seen.begin()));
        }
    }

    const std::vector<int64_t>& starts() const { return starts_; }
    const std::vector<int64_t>& rows() const { return rows_; }

    const double* fill(const reference::Jacobian& jacobian, const std::vector<double>& damping) {
        std::fill(values_.begin(), values_.end(), 0.0);
        for (size_t i = 0; i < jacobian.image.size(); ++i) {
            const double* f = jacobian.image_blocks.data() + i * 2 * static_cast<size_t>(columns_);
            const double* e = jacobian.point_blocks.data() + i * 6;
            const int64_t first_column = int64_t{jacobian.image[i]} * columns_;
            for (int a = 0; a < columns_; ++a) {
                double* column = values_.data() + starts_[static_cast<size_t>(first_column + a)];
                for (int b = a; b < columns_; ++b)
                    column[b - a] += f[a] * f[b] + f[columns_ + a] * f[columns_ + b];
                double* below = column + (columns_ - a) + places_[i];
                for (int k = 0; k < 3; ++k) below[k] += f[a] * e[k] + f[columns_ + a] * e[3 + k];
            }
            const int64_t point_column = num_f_ + 3 * int64_t{jacobian.point[i]};
            for (int a = 0; a < 3; ++a) {
                double* column = values_.data() + starts_[static_cast<size_t>(point_column + a)];
                for (int b = a; b < 3; ++b) column[b - a] += e[a] * e[b] + e[3 + a] * e[3 + b];
            }
        }
        for (size_t k = 0; k < damping.size(); ++k)
            values_[static_cast<size_t>(starts_[k])] += damping[k];
        return values_.data();
    }

private:
    int columns_;
    int32_t num_images_, num_points_;
    int64_t num_f_;
    std::vector<int64_t> starts_, rows_;
    std::vector<double> values_;
    std::vector<int64_t>
        places_;  // of each observation's point among the rows below its image's block
};

Solve make_solver(const std::string& name, const Problem& problem, const ParameterLayout& layout,
                  const reference::Jacobian& jacobian) {
    if (name == "schur") {
        const auto schur = std::make_shared<reference::DirectSchur>(problem, layout);
        return [schur](const reference::Jacobian& j, const std::vector<double>& gradient,
                       const std::vector<double>& damping, std::vector<double>& step) {
            return schur->solve(j, gradient.data(), damping.data(), {}, step.data());
        };
    }
    require(name == "normal", "the solver is ", name, ", but it must be normal or schur");
    const auto matrix = std::make_shared<NormalMatrix>(problem, jacobian);
    const auto cholesky =
        std::make_shared<reference::SparseCholesky>(matrix->starts(), matrix->rows());
    return [matrix, cholesky](const reference::Jacobian& j, const std::vector<double>& gradient,
                              const std::vector<double>& damping, std::vector<double>& step) {
        if (!cholesky->factorize(matrix->fill(j, damping))) return false;
        for (size_t k = 0; k < step.size(); ++k) step[k] = -gradient[k];
        cholesky->solve(step.data(), step.data());
        return std::all_of(step.begin(), step.end(), [](double x) { return std::isfinite(x); });
    };
}

std::vector<double> diagonal_of(const reference::Jacobian& jacobian, const ParameterLayout& layout,
                                size_t num_parameters) {
    std::vector<double> diagonal(num_parameters, 0.0);
    const int columns = jacobian.columns;
    for (size_t i = 0; i < 2 * jacobian.image.size(); ++i) {
        const double* f = jacobian.image_blocks.data() + i * static_cast<size_t>(columns);
        const double* e = jacobian.point_blocks.data() + i * 3;
        double* d_f =
            diagonal.data() + layout.pose_offset[static_cast<size_t>(jacobian.image[i / 2])];
        double* d_e = diagonal.data() + layout.num_f + 3 * int64_t{jacobian.point[i / 2]};
        for (int k = 0; k < columns; ++k) d_f[k] += f[k] * f[k];
        for (int k = 0; k < 3; ++k) d_e[k] += e[k] * e[k];
    }
    return diagonal;
}

// Of J's quadratic model: -g^T step - 1/2 |J step|^2.
double model_decrease(const Problem& problem, const ParameterLayout& layout,
                      const reference::Jacobian& jacobian, const std::vector<double>& gradient,
                      const std::vector<double>& step) {
    double sum = 0;
    for (size_t k = 0; k < step.size(); ++k) sum -= gradient[k] * step[k];
    for (const double y : reference::jx(problem, layout, jacobian, step)) sum -= 0.5 * y * y;
    return sum;
}

nlohmann::json minimize(Problem& problem, const std::string& name, int max_iterations,
                        double function_tolerance) {
    constexpr double initial_radius = 1e4, max_radius = 1e16, min_relative_decrease = 1e-3;
    constexpr int marquardt = 1;
    const Stopwatch watch;
    const ParameterLayout layout(problem);
    std::vector<double> residuals(2 * problem.observations.size());
    double cost = reference::residual(problem, residuals.data()).cost;
    reference::Jacobian jacobian = reference::jacobian(problem, layout);
    const Solve solve = make_solver(name, problem, layout, jacobian);
    TrustRegion trust_region(initial_radius, max_radius);
    nlohmann::json rows = {{{"cost", cost}, {"seconds", watch.seconds()}, {"is_accepted", true}}};
    std::vector<double> gradient = reference::jty(problem, layout, jacobian, residuals);
    std::vector<double> diagonal = diagonal_of(jacobian, layout, gradient.size());
    std::vector<double> step(gradient.size()), damping;
    std::vector<double> scale = layout.scale;
    scale.resize(gradient.size(), 1.0);
    for (int iteration = 0; iteration < max_iterations; ++iteration) {
        damping = reference::damping_diagonal(marquardt, 1e-6, 1e32, scale, diagonal, diagonal);
        for (double& d : damping) d *= trust_region.lambda();
        bool is_accepted = false;
        double change = 0;
        if (solve(jacobian, gradient, damping, step)) {
            Problem trial = problem;
            apply_step(layout, step.data(), trial);
            const double trial_cost = reference::residual(trial, residuals.data()).cost;
            change = cost - trial_cost;
            const double gain_ratio =
                change / model_decrease(problem, layout, jacobian, gradient, step);
            is_accepted = change > 0 && gain_ratio > min_relative_decrease;
            if (is_accepted) {
                problem = std::move(trial);
                cost = trial_cost;
                trust_region.accept(gain_ratio);
                jacobian = reference::jacobian(problem, layout);
                gradient = reference::jty(problem, layout, jacobian, residuals);
                diagonal = diagonal_of(jacobian, layout, gradient.size());
            }
        }
        if (!is_accepted) trust_region.reject();
        rows.push_back(
            {{"cost", cost}, {"seconds", watch.seconds()}, {"is_accepted", is_accepted}});
        if (is_accepted && change <= function_tolerance * (cost + change)) break;
    }
    return {{"rows", rows}, {"final_cost", cost}, {"total_seconds", watch.seconds()}};
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 6) {
        std::fprintf(stderr,
                     "usage: %s FILE OUTPUT normal|schur MAX_ITERATIONS FUNCTION_TOLERANCE\n",
                     argv[0]);
        return EXIT_FAILURE;
    }
    try {
        Problem problem = read_bal(argv[1]);
        const nlohmann::json summary =
            minimize(problem, argv[3], std::stoi(argv[4]), std::stod(argv[5]));
        write_bal(problem, argv[2]);
        std::printf("%s\n", summary.dump().c_str());
        return EXIT_SUCCESS;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "paper_baseline: %s\n", error.what());
        return EXIT_FAILURE;
    }
}
