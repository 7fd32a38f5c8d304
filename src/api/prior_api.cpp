// SPDX-License-Identifier: Apache-2.0
// Priors of poses, intrinsics and points.
#include <cmath>

#include "api/numbers.hpp"
#include "reference/bundle.hpp"

namespace clba {
namespace {

// Checks everything before it touches the problem, whose mirror on the device goes.
template <class Read>
clba_status replaced(clba_problem* handle, int32_t count, Read&& read) {
    return guarded([&] {
        require_pointer(handle, "problem");
        require(count >= 0, "count = ", count, ", but it must be >= 0");
        read(handle->problem);
        handle->mirror.reset();
    });
}

// Indices of `what`, each of which may occur once.
class Subjects {
public:
    Subjects(const int32_t* indices, size_t stride, const char* name, int32_t count, int32_t limit,
             const char* limit_name)
        : rows_(indices, stride, 1, name, count),
          name_(name),
          limit_name_(limit_name),
          row_of_(static_cast<size_t>(limit), -1) {}

    int32_t get(int32_t i) {
        const int32_t index = rows_.get(i);
        const auto limit = static_cast<int32_t>(row_of_.size());
        require(index >= 0 && index < limit, name_, "[", i, "] = ", index, ", but ", limit_name_,
                " = ", limit);
        require(row_of_[index] < 0, name_, "[", i, "] = ", index, ", but ", name_, "[",
                row_of_[index], "] is the same, and each may have one prior; combine the two");
        row_of_[index] = i;
        return index;
    }

private:
    Rows<const int32_t> rows_;
    const char* name_;
    const char* limit_name_;
    std::vector<int32_t> row_of_;
};

Pose read_target(const Rows<const double>& rows, int32_t i) {
    Pose pose = read_pose(rows, i, "poses");
    pose.rotation = normalized(pose.rotation);
    return pose;
}

// L^-1 of an n x n covariance, get(row, column), as rows of `stride` numbers. Infinite variances
// are allowed where takes_infinity.
template <class Get>
void read_whitening(const Get& get, int n, int32_t i, const char* name, bool takes_infinity,
                    double* whitening, int stride) {
    const auto count = static_cast<size_t>(n);
    std::vector<double> covariance(count * count), scale(count, 1.0), factor(count * count);
    for (int r = 0; r < n; ++r) {
        const double variance = get(r, r);
        const bool is_infinite = takes_infinity && std::isinf(variance);
        require(variance > 0 && (is_infinite || std::isfinite(variance)), name, "[", i, "][", r,
                "][", r, "] = ", variance, ", but a variance must be ",
                takes_infinity ? "> 0" : "finite and > 0");
        if (is_infinite) scale[static_cast<size_t>(r)] = 0;
    }
    for (int r = 0; r < n; ++r) {
        for (int c = 0; c < n; ++c) {
            const double value = get(r, c), mirrored = get(c, r);
            const bool is_left_out =
                scale[static_cast<size_t>(r)] == 0 || scale[static_cast<size_t>(c)] == 0;
            if (r != c) {
                require(!is_left_out || value == 0, name, "[", i, "][", r, "][", c, "] = ", value,
                        ", but it must be 0 beside a variance of infinity");
                const double limit = is_left_out ? 0 : 1e-8 * std::sqrt(get(r, r) * get(c, c));
                require(std::abs(value - mirrored) <= limit, name, "[", i, "][", r, "][", c,
                        "] = ", value, " and [", c, "][", r, "] = ", mirrored,
                        ", but a covariance is symmetric");
            }
            covariance[static_cast<size_t>(r * n + c)] =
                is_left_out ? (r == c ? 1.0 : 0.0) : (value + mirrored) / 2;
        }
    }
    require(reference::inverse_factor(n, covariance.data(), scale.data(), factor.data()), name, "[",
            i,
            "] is not positive definite, but a covariance must be: its variances are "
            "positive, so that covariances are too large for them");
    for (int r = 0; r < n; ++r) std::copy_n(factor.data() + r * n, n, whitening + r * stride);
}

template <int n>
std::array<double, n * n> whitening_of(const Rows<const double>& covariances, int32_t i) {
    std::array<double, n * n> whitening;
    read_whitening([&](int r, int c) { return covariances.get(i, static_cast<size_t>(r * n + c)); },
                   n, i, "covariances", false, whitening.data(), n);
    return whitening;
}

// Priors of positions: images' centres, or points.
template <class Prior>
std::vector<Prior> read_positions(Subjects subjects, int32_t count, const double* positions,
                                  size_t positions_stride, const double* covariances,
                                  size_t covariances_stride) {
    const Rows targets(positions, positions_stride, 3, "positions", count);
    const Rows rows(covariances, covariances_stride, 9, "covariances", count);
    std::vector<Prior> priors(static_cast<size_t>(count));
    for (int32_t i = 0; i < count; ++i)
        priors[i] = {subjects.get(i), read_finite<3>(targets, i, "positions"),
                     whitening_of<3>(rows, i)};
    return priors;
}

// The rows of a caller's array that differ in length: without gaps if the stride is 0.
class RaggedRows {
public:
    RaggedRows(const double* data, size_t stride, const char* name, int32_t count)
        : at_(reinterpret_cast<const unsigned char*>(data)), stride_(stride), name_(name) {
        if (count > 0) require_pointer(data, name);
    }
    Rows<const double> next(size_t size, int32_t i) {
        const size_t bytes = size * sizeof(double);
        require(stride_ == 0 || stride_ >= bytes, name_, " has a stride of ", stride_,
                " bytes, but row ", i, " has ", bytes);
        const Rows<const double> row(reinterpret_cast<const double*>(at_), 0, size, name_, 1);
        at_ += stride_ ? stride_ : bytes;
        return row;
    }

private:
    const unsigned char* at_;
    size_t stride_;
    const char* name_;
};

}  // namespace
}  // namespace clba

using namespace clba;

clba_status clba_problem_set_position_priors(clba_problem* problem, int32_t count,
                                             const int32_t* images, size_t images_stride,
                                             const double* positions, size_t positions_stride,
                                             const double* covariances, size_t covariances_stride) {
    return replaced(problem, count, [&](Problem& p) {
        p.priors.positions = read_positions<PositionPrior>(
            Subjects(images, images_stride, "images", count, p.num_images(), "num_images"), count,
            positions, positions_stride, covariances, covariances_stride);
    });
}

clba_status clba_problem_set_pose_priors(clba_problem* problem, int32_t count,
                                         const int32_t* images, size_t images_stride,
                                         const double* poses, size_t poses_stride,
                                         const double* covariances, size_t covariances_stride) {
    return replaced(problem, count, [&](Problem& p) {
        Subjects subjects(images, images_stride, "images", count, p.num_images(), "num_images");
        const Rows targets(poses, poses_stride, 7, "poses", count);
        const Rows rows(covariances, covariances_stride, 36, "covariances", count);
        std::vector<PosePrior> priors(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i)
            priors[i] = {subjects.get(i), read_target(targets, i), whitening_of<6>(rows, i)};
        p.priors.poses = std::move(priors);
    });
}

clba_status clba_problem_set_intrinsics_priors(clba_problem* problem, int32_t count,
                                               const int32_t* cameras, size_t cameras_stride,
                                               const double* params, size_t params_stride,
                                               const double* covariances,
                                               size_t covariances_stride) {
    return replaced(problem, count, [&](Problem& p) {
        Subjects subjects(cameras, cameras_stride, "cameras", count, p.num_cameras(),
                          "num_cameras");
        RaggedRows targets(params, params_stride, "params", count);
        RaggedRows rows(covariances, covariances_stride, "covariances", count);
        std::vector<IntrinsicsPrior> priors(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i) {
            priors[i].camera = subjects.get(i);
            const int n = p.cameras[priors[i].camera].num_params();
            const Rows<const double> target = targets.next(static_cast<size_t>(n), i);
            const Rows<const double> row = rows.next(static_cast<size_t>(n * n), i);
            for (int k = 0; k < n; ++k) {
                priors[i].params[k] = target.get(0, static_cast<size_t>(k));
                require(std::isfinite(priors[i].params[k]), "params[", i, "][", k,
                        "] = ", priors[i].params[k], ", but it must be finite");
            }
            read_whitening([&](int r, int c) { return row.get(0, static_cast<size_t>(r * n + c)); },
                           n, i, "covariances", true, priors[i].whitening.data(),
                           max_camera_params);
        }
        p.priors.intrinsics = std::move(priors);
    });
}

clba_status clba_problem_set_point_priors(clba_problem* problem, int32_t count,
                                          const int32_t* points, size_t points_stride,
                                          const double* positions, size_t positions_stride,
                                          const double* covariances, size_t covariances_stride) {
    return replaced(problem, count, [&](Problem& p) {
        p.priors.points = read_positions<PointPrior>(
            Subjects(points, points_stride, "points", count, p.num_points(), "num_points"), count,
            positions, positions_stride, covariances, covariances_stride);
    });
}

clba_status clba_problem_set_relative_pose_priors(clba_problem* problem, int32_t count,
                                                  const int32_t* pairs, size_t pairs_stride,
                                                  const double* poses, size_t poses_stride,
                                                  const double* covariances,
                                                  size_t covariances_stride) {
    return replaced(problem, count, [&](Problem& p) {
        const Rows images(pairs, pairs_stride, 2, "pairs", count);
        const Rows targets(poses, poses_stride, 7, "poses", count);
        const Rows rows(covariances, covariances_stride, 36, "covariances", count);
        std::vector<RelativePosePrior> priors(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i) {
            for (size_t k = 0; k < 2; ++k)
                require(images.get(i, k) >= 0 && images.get(i, k) < p.num_images(), "pairs[", i,
                        "][", k, "] = ", images.get(i, k), ", but num_images = ", p.num_images());
            priors[i] = {images.get(i, 0), images.get(i, 1), read_target(targets, i),
                         whitening_of<6>(rows, i)};
            require(priors[i].first != priors[i].second, "pairs[", i, "] = (", priors[i].first,
                    ", ", priors[i].second, "), but a relative pose is that of two images");
        }
        p.priors.relative_poses = std::move(priors);
    });
}
