// SPDX-License-Identifier: Apache-2.0
// Covariances and gauges.
#include <algorithm>
#include <array>
#include <cmath>

#include "api/handles.hpp"
#include "api/mirror.hpp"
#include "base/stopwatch.hpp"
#include "covariance/covariance.hpp"

struct clba_covariance {
    clba::Covariance blocks;
    clba_covariance_info info;
};

namespace clba {
namespace {

clba_covariance_options default_covariance_options() {
    const CovarianceOptions defaults;
    clba_covariance_options options{};
    options.struct_size = sizeof options;
    options.gauge = CLBA_GAUGE_DEFAULT;
    for (int32_t& image : options.gauge_images) image = -1;
    for (int32_t& point : options.gauge_points) point = -1;
    options.method = CLBA_COVARIANCE_AUTO;
    options.max_linear_solver_iterations = defaults.max_linear_solver_iterations;
    options.relative_error = defaults.relative_error;
    return options;
}

clba_gauge_target default_gauge_target() {
    clba_gauge_target target{};
    target.struct_size = sizeof target;
    target.gauge = CLBA_GAUGE_DEFAULT;
    for (int32_t& image : target.images) image = -1;
    for (int32_t& point : target.points) point = -1;
    return target;
}

GaugeChoice checked_gauge(int32_t gauge, const int32_t* images, const int32_t* points) {
    require(clba_covariance_gauge_name(gauge) != nullptr, "gauge = ", gauge,
            ", but clba.h lists no such value");
    GaugeChoice choice;
    choice.gauge = static_cast<Gauge>(gauge);
    std::copy_n(images, choice.images.size(), choice.images.begin());
    std::copy_n(points, choice.points.size(), choice.points.begin());
    return choice;
}

CovarianceOptions checked_options(const clba_covariance_options& given, const Problem& problem) {
    CovarianceOptions options;
    options.gauge = checked_gauge(given.gauge, given.gauge_images, given.gauge_points);
    require(clba_covariance_method_name(given.method) != nullptr, "method = ", given.method,
            ", but clba.h lists no such value");
    options.method = static_cast<CovarianceMethod>(given.method);
    options.apply_variance_factor = given.apply_variance_factor != 0;
    options.all_points = given.all_points != 0;
    require(given.num_points >= 0, "num_points = ", given.num_points, ", but it must be >= 0");
    if (given.num_points > 0) require_pointer(given.points, "points");
    if (!options.all_points && given.num_points > 0)
        options.points.assign(given.points, given.points + given.num_points);
    std::vector<char> is_listed(problem.points.size(), 0);
    for (size_t k = 0; k < options.points.size(); ++k) {
        const int32_t point = options.points[k];
        require(point >= 0 && point < problem.num_points(), "points[", k, "] = ", point,
                ", but num_points = ", problem.num_points());
        require(!is_listed[point], "points[", k, "] = ", point,
                ", which the list has already; name each point once");
        is_listed[point] = 1;
    }
    require(given.num_samples >= 0 && given.num_samples != 1, "num_samples = ", given.num_samples,
            ", but it must be >= 2, or 0 for as many as relative_error asks for");
    require(given.relative_error > 1e-4 && given.relative_error < 1,
            "relative_error = ", given.relative_error, ", but it must be in (1e-4, 1)");
    require(given.max_linear_solver_iterations >= 1,
            "max_linear_solver_iterations = ", given.max_linear_solver_iterations,
            ", but it must be >= 1");
    options.num_samples = given.num_samples;
    options.relative_error = given.relative_error;
    options.max_linear_solver_iterations = given.max_linear_solver_iterations;
    options.max_bytes = given.max_bytes;
    options.seed = given.seed;
    return options;
}

clba_covariance_info public_info(const Covariance& covariance, bool is_applied) {
    clba_covariance_info info{};
    info.struct_size = sizeof info;
    info.gauge = static_cast<int32_t>(covariance.gauge.gauge);
    const bool of_images = covariance.gauge.gauge == Gauge::first_image_and_baseline;
    const bool of_points = covariance.gauge.gauge == Gauge::three_points;
    for (size_t k = 0; k < 2; ++k)
        info.gauge_images[k] = of_images ? covariance.gauge.images[k] : -1;
    for (size_t k = 0; k < 3; ++k)
        info.gauge_points[k] = of_points ? covariance.gauge.points[k] : -1;
    info.num_freedoms = covariance.num_freedoms;
    info.method = static_cast<int32_t>(covariance.method);
    info.num_samples = covariance.num_samples;
    info.variance_factor_is_applied = is_applied;
    info.num_images = static_cast<int32_t>(covariance.image_size.size());
    info.num_cameras = static_cast<int32_t>(covariance.camera_size.size());
    info.num_points = static_cast<int64_t>(covariance.points.size());
    if (covariance.num_samples > 0) info.relative_error = std::sqrt(2.0 / covariance.num_samples);
    info.cost = covariance.cost;
    info.variance_factor = covariance.variance_factor;
    info.redundancy = covariance.redundancy;
    info.num_undetermined_parameters = covariance.num_undetermined_parameters;
    info.num_undetermined_points = covariance.num_undetermined_points;
    info.num_linear_solver_iterations = covariance.num_linear_solver_iterations;
    info.bytes = covariance.bytes;
    info.form_seconds = covariance.form_seconds;
    info.factor_seconds = covariance.factor_seconds;
    info.inverse_seconds = covariance.inverse_seconds;
    info.point_seconds = covariance.point_seconds;
    return info;
}

struct Block {
    int32_t size;
    const double* values;  // row-major
    int32_t stride;
};

// R^T P R, with P the covariance of v in dC = -R^T v.
std::array<double, 9> center_covariance(const Covariance& covariance, int64_t image) {
    const std::array<double, 9>& r = covariance.rotations[image];
    const int32_t stride = covariance.image_size[image];
    const double* p = covariance.images.data() + covariance.image_begin[image] + 3 * stride + 3;
    std::array<double, 9> result{};
    const bool is_infinite = std::isinf(p[0]);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            double& value = result[3 * i + j];
            for (int k = 0; k < 3 && !is_infinite; ++k)
                for (int m = 0; m < 3; ++m)
                    value += r[3 * k + i] * p[k * stride + m] * r[3 * m + j];
            if (is_infinite && i == j) value = p[0];
        }
    }
    return result;
}

int64_t num_rows(const Covariance& covariance, int32_t block) {
    if (block == CLBA_BLOCK_INTRINSICS) return static_cast<int64_t>(covariance.camera_size.size());
    if (block == CLBA_BLOCK_POINT) return static_cast<int64_t>(covariance.points.size());
    return static_cast<int64_t>(covariance.image_size.size());
}

Block block_of(const Covariance& covariance, int32_t block, int64_t row,
               const std::array<double, 9>& center) {
    switch (block) {
        case CLBA_BLOCK_POSE:
            return {num_pose_params, covariance.images.data() + covariance.image_begin[row],
                    covariance.image_size[row]};
        case CLBA_BLOCK_CENTER:
            return {3, center.data(), 3};
        case CLBA_BLOCK_INTRINSICS:
            return {covariance.camera_size[row],
                    covariance.cameras.data() + covariance.camera_begin[row],
                    covariance.camera_size[row]};
        case CLBA_BLOCK_POSE_AND_INTRINSICS:
            return {covariance.image_size[row],
                    covariance.images.data() + covariance.image_begin[row],
                    covariance.image_size[row]};
        default:
            return {3, covariance.point_values.data() + 9 * row, 3};
    }
}

// Of entry ij of the mean of n squares x x^T of normal samples: sqrt((P_ii P_jj + P_ij^2) / n).
double standard_error(const Block& block, int32_t i, int32_t j, int32_t num_samples) {
    if (num_samples == 0) return 0;
    const auto at = [&](int32_t r, int32_t c) { return block.values[r * block.stride + c]; };
    if (std::isinf(at(i, i)) || std::isinf(at(j, j))) return i == j ? at(i, i) : 0;
    return std::sqrt((at(i, i) * at(j, j) + at(i, j) * at(i, j)) / num_samples);
}

void get_blocks(const Covariance& covariance, int32_t block, int64_t first, int64_t count,
                double* values, double* standard_errors, size_t stride) {
    const int64_t rows = num_rows(covariance, block);
    require(first >= 0 && count >= 0 && first <= rows && count <= rows - first, "rows [", first,
            ", ", first, " + ", count, ") are asked for, but there are ", rows);
    if (count > 0) require_pointer(values, "values");
    size_t offset = 0;
    for (int64_t row = first; row < first + count; ++row) {
        const std::array<double, 9> center = block == CLBA_BLOCK_CENTER
                                                 ? center_covariance(covariance, row)
                                                 : std::array<double, 9>{};
        const Block of_row = block_of(covariance, block, row, center);
        const auto size = static_cast<size_t>(of_row.size);
        require(stride == 0 || stride >= size * size * sizeof(double), "values has a stride of ",
                stride, " bytes, but row ", row, " has ", size * size * sizeof(double));
        for (int32_t i = 0; i < of_row.size; ++i) {
            for (int32_t j = 0; j < of_row.size; ++j) {
                const size_t at = offset + sizeof(double) * (static_cast<size_t>(i) * size +
                                                             static_cast<size_t>(j));
                std::memcpy(reinterpret_cast<unsigned char*>(values) + at,
                            &of_row.values[i * of_row.stride + j], sizeof(double));
                if (!standard_errors) continue;
                const double error = standard_error(of_row, i, j, covariance.num_samples);
                std::memcpy(reinterpret_cast<unsigned char*>(standard_errors) + at, &error,
                            sizeof error);
            }
        }
        offset += stride ? stride : size * size * sizeof(double);
    }
}

}  // namespace
}  // namespace clba

using namespace clba;

const char* clba_covariance_gauge_name(int32_t gauge) {
    if (gauge < CLBA_GAUGE_DEFAULT || gauge > CLBA_GAUGE_INNER) return nullptr;
    return gauge_name(static_cast<Gauge>(gauge));
}

const char* clba_covariance_method_name(int32_t method) {
    switch (method) {
        case CLBA_COVARIANCE_AUTO:
            return "auto";
        case CLBA_COVARIANCE_EXACT:
            return "exact";
        case CLBA_COVARIANCE_SAMPLED:
            return "sampled";
        default:
            return nullptr;
    }
}

clba_status clba_covariance_options_init(clba_covariance_options* options, size_t struct_size) {
    return guarded(
        [&] { init_struct(options, struct_size, default_covariance_options(), "options"); });
}

clba_status clba_problem_covariance(clba_problem* problem, clba_context* context,
                                    const clba_covariance_options* options,
                                    clba_covariance** covariance) {
    if (covariance) *covariance = nullptr;
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(context, "context");
        require_pointer(covariance, "covariance");
        const clba_covariance_options given =
            copied_in(options, default_covariance_options(), "options");
        const CovarianceOptions internal = checked_options(given, problem->problem);
        require(!problem->problem.observations.empty(),
                "the problem has no observations, and so its parameters have no covariances");
        const Stopwatch watch;
        auto result = std::make_unique<clba_covariance>();
        with_mirror(problem, context, Precision::double_precision, [&](DeviceProblem& device) {
            result->blocks = compute_covariance(problem->problem, device, internal);
        });
        result->info = public_info(result->blocks, internal.apply_variance_factor);
        result->info.total_seconds = watch.seconds();
        *covariance = result.release();
    });
}

void clba_covariance_release(clba_covariance* covariance) {
    delete covariance;
}

clba_status clba_covariance_get_info(const clba_covariance* covariance,
                                     clba_covariance_info* info) {
    return guarded([&] {
        require_pointer(covariance, "covariance");
        copy_out(covariance->info, info, "info");
    });
}

clba_status clba_covariance_get(const clba_covariance* covariance, int32_t block, int64_t first,
                                int64_t count, double* values, double* standard_errors,
                                size_t stride) {
    return guarded([&] {
        require_pointer(covariance, "covariance");
        require(block >= CLBA_BLOCK_POSE && block <= CLBA_BLOCK_POINT, "block = ", block,
                ", but the blocks are ", int{CLBA_BLOCK_POSE}, " to ", int{CLBA_BLOCK_POINT});
        get_blocks(covariance->blocks, block, first, count, values, standard_errors, stride);
    });
}

clba_status clba_gauge_target_init(clba_gauge_target* target, size_t struct_size) {
    return guarded([&] { init_struct(target, struct_size, default_gauge_target(), "target"); });
}

clba_status clba_problem_fix_gauge(clba_problem* problem, const clba_gauge_target* target) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(target, "target");
        const clba_gauge_target given = copied_in(target, default_gauge_target(), "target");
        GaugeChoice choice = checked_gauge(given.gauge, given.images, given.points);
        if (choice.gauge == Gauge::automatic) choice.gauge = Gauge::first_image_and_baseline;
        GaugeTarget internal;
        const auto finite = [](const double* values, int64_t count, const char* name) {
            require_pointer(values, name);
            for (int64_t k = 0; k < count; ++k)
                require(std::isfinite(values[k]), name, "[", k, "] = ", values[k],
                        ", but it must be finite");
        };
        std::vector<Point> centers;
        if (choice.gauge == Gauge::first_image_and_baseline) {
            finite(given.pose, 7, "pose");
            std::copy_n(given.pose, 4, internal.pose.rotation.begin());
            std::copy_n(given.pose + 4, 3, internal.pose.translation.begin());
            double norm = 0;
            for (const double q : internal.pose.rotation) norm += q * q;
            require(norm > 0, "pose has the quaternion 0, which is no rotation");
            internal.pose.rotation = normalized(internal.pose.rotation);
            internal.baseline = given.baseline;
        } else if (choice.gauge == Gauge::three_points) {
            finite(given.xyz, 9, "xyz");
            for (size_t k = 0; k < 3; ++k)
                std::copy_n(given.xyz + 3 * k, 3, internal.points[k].begin());
        } else if (choice.gauge == Gauge::inner) {
            const int64_t count = problem->problem.num_images();
            require_pointer(given.centers, "centers");
            centers.resize(static_cast<size_t>(count));
            for (int64_t i = 0; i < count; ++i) {
                std::copy_n(given.centers + 3 * i, 3, centers[i].begin());
                int num_finite = 0, num_nan = 0;
                for (const double value : centers[i]) {
                    num_finite += std::isfinite(value);
                    num_nan += std::isnan(value);
                }
                require(num_finite == 3 || num_nan == 3, "centers[", i, "] = (", centers[i][0],
                        ", ", centers[i][1], ", ", centers[i][2],
                        "), but it must be finite, or NaN in all three: not known");
            }
            internal.centers = &centers;
        }
        fix_gauge(choice, internal, problem->problem);
    });
}
