// SPDX-License-Identifier: Apache-2.0
#include "reference/priors.hpp"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>

namespace clba::reference {
namespace {

using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Eigen::Vector3d;

constexpr int max_residuals = std::max(num_pose_params, max_camera_params);
// Of two poses, each of a frame and a sensor.
constexpr int max_parameters = std::max(4 * num_pose_params, max_camera_params);

using Residual = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, max_residuals, 1>;
using Block = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, max_residuals,
                            max_parameters>;

RowMajor3 rotation_of(const std::array<double, 4>& quaternion) {
    return Eigen::Map<const RowMajor3>(rotation_matrix(quaternion).data());
}

Vector3d vector_of(const std::array<double, 3>& values) {
    return Vector3d(values[0], values[1], values[2]);
}

std::array<double, 4> conjugate(const std::array<double, 4>& q) {
    return {q[0], -q[1], -q[2], -q[3]};
}

RowMajor3 cross_product_matrix(const Vector3d& a) {
    RowMajor3 matrix;
    matrix << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
    return matrix;
}

// d log(exp(w) exp(phi)) / d w at w = 0:
//   I - 1/2 [phi]_x + c [phi]_x^2,  c = (1 - (a / 2) cot(a / 2)) / a^2,  a = |phi|.
RowMajor3 log_derivative(const Vector3d& phi) {
    const double a2 = phi.squaredNorm(), half = std::sqrt(a2) / 2;
    // The Taylor series where the difference loses digits.
    const double c = a2 < 1e-2 ? 1.0 / 12 + a2 * (1.0 / 720 + a2 * (1.0 / 30240 + a2 / 1209600))
                               : (1 - half / std::tan(half)) / a2;
    const RowMajor3 phi_x = cross_product_matrix(phi);
    return RowMajor3::Identity() - 0.5 * phi_x + c * phi_x * phi_x;
}

// h(x) - target, and its Jacobian if that is wanted (of the right size, 0 before).

void evaluate(const PositionPrior& prior, const Pose& pose, Residual& r, Block* j) {
    r = vector_of(camera_center(pose)) - vector_of(prior.position);
    if (j) *j = -rotation_of(pose.rotation).transpose();
}

void evaluate(const PosePrior& prior, const Pose& pose, Residual& r, Block* j) {
    const Vector3d phi = vector_of(rotation_vector_from_quaternion(
        quaternion_product(pose.rotation, conjugate(prior.pose.rotation))));
    r.head<3>() = phi;
    r.tail<3>() = vector_of(camera_center(pose)) - vector_of(camera_center(prior.pose));
    if (!j) return;
    j->topLeftCorner<3, 3>() = log_derivative(phi);
    j->bottomRightCorner<3, 3>() = -rotation_of(pose.rotation).transpose();
}

// With T_second T_first^-1 = (R, t) and that of the prior (M, m): phi = log(M^T R) and M^T (t - m),
// of which t moves by [w2]_x t + v2 - R v1 and R by [w2]_x R - R [w1]_x.
void evaluate(const RelativePosePrior& prior, const Pose& first, const Pose& second, Residual& r,
              Block* j) {
    const auto relative = quaternion_product(second.rotation, conjugate(first.rotation));
    const RowMajor3 rotation = rotation_of(relative), m = rotation_of(prior.pose.rotation);
    const Vector3d t = vector_of(second.translation) - rotation * vector_of(first.translation);
    const Vector3d phi = vector_of(rotation_vector_from_quaternion(
        quaternion_product(conjugate(prior.pose.rotation), relative)));
    r.head<3>() = phi;
    r.tail<3>() = m.transpose() * (t - vector_of(prior.pose.translation));
    if (!j) return;
    const RowMajor3 of_log = log_derivative(phi);
    j->block<3, 3>(0, 0) = -of_log * m.transpose() * rotation;
    j->block<3, 3>(3, 3) = -m.transpose() * rotation;
    j->block<3, 3>(0, 6) = of_log * m.transpose();
    j->block<3, 3>(3, 6) = -m.transpose() * cross_product_matrix(t);
    j->block<3, 3>(3, 9) = m.transpose();
}

Vector3d whitened(const PointPrior& prior, const Point& point) {
    return Eigen::Map<const RowMajor3>(prior.whitening.data()) *
           (vector_of(point) - vector_of(prior.position));
}

}  // namespace

// A prior with the F scalars that it is about, -1 for constants, in the order of the columns of its
// Jacobian; evaluate(r, j) whitens both.
struct ImagePriors::Term {
    const std::vector<int32_t>& scalars;
};

namespace {

// Columns of an image's pose, of which there are `count` from `first`, that are to become those of
// its frame (and, with six more, its sensor).
struct PoseColumns {
    int first = 0, count = 0;
    int32_t sensor = -1;  // -1: the pose is the image's own
};

// j of images to j of parameters.
void transform_columns(const std::vector<PoseColumns>& poses, const std::vector<Pose>& sensors,
                       Block& j) {
    const Block of_images = j;
    Eigen::Index to = 0;
    for (const PoseColumns& pose : poses) to += pose.sensor < 0 ? pose.count : 2 * num_pose_params;
    j.setZero(of_images.rows(), to);
    to = 0;
    for (const PoseColumns& pose : poses) {
        const auto columns = of_images.middleCols(pose.first, pose.count);
        if (pose.sensor < 0) {
            j.middleCols(to, pose.count) = columns;
            to += pose.count;
            continue;
        }
        const std::array<double, 36> a = frame_tangent(sensors[pose.sensor]);
        const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> of_frame(a.data());
        // The columns are a pose's last.
        j.middleCols<6>(to) = columns * of_frame.bottomRows(pose.count);
        j.middleCols(to + 2 * num_pose_params - pose.count, pose.count) = columns;
        to += 2 * num_pose_params;
    }
}

}  // namespace

// use(term, evaluate): evaluate(images, cameras, sensors, r, j) fills the whitened residual and,
// unless j is NULL, its Jacobian.
template <class Use>
void ImagePriors::for_each_term(Use&& use) const {
    std::vector<int32_t> scalars;
    std::vector<PoseColumns> poses;
    int num_columns = 0;  // of images
    bool is_composed = false;
    const auto add = [&](int32_t first, int count) {
        for (int32_t k = first; k < first + count; ++k) scalars.push_back(scale_[k] > 0 ? k : -1);
    };
    // The last `count` of its pose.
    const auto add_pose = [&](int32_t image, int count) {
        const int32_t sensor = image_sensor_.empty() ? -1 : image_sensor_[image];
        poses.push_back({num_columns, count, sensor});
        num_columns += count;
        is_composed = is_composed || sensor >= 0;
        if (sensor < 0) {
            add(pose_offset_[image] + num_pose_params - count, count);
        } else {
            add(pose_offset_[image], num_pose_params);
            add(sensor_offset_[sensor], num_pose_params);
        }
    };
    const auto visit = [&](const auto& prior, int n, int stride, auto&& evaluate_prior) {
        if (!is_composed) num_columns = static_cast<int>(scalars.size());
        use(Term{scalars}, [&](const std::vector<Image>& images, const std::vector<Camera>& cameras,
                               const std::vector<Pose>& sensors, Residual& r, Block* j) {
            r.resize(n);
            if (j) j->setZero(n, num_columns);
            evaluate_prior(images, cameras, r, j);
            if (j && is_composed) transform_columns(poses, sensors, *j);
            const Eigen::Map<const Block, 0, Eigen::OuterStride<>> whitening(
                prior.whitening.data(), n, n, Eigen::OuterStride<>(stride));
            const Residual unweighted = r;
            r = whitening * unweighted;
            if (!j) return;
            const Block unweighted_j = *j;
            *j = whitening * unweighted_j;
        });
        scalars.clear();
        poses.clear();
        num_columns = 0;
        is_composed = false;
    };
    for (const PositionPrior& prior : priors_.positions) {
        add_pose(prior.image, 3);
        visit(prior, 3, 3, [&](const auto& images, const auto&, Residual& r, Block* j) {
            evaluate(prior, images[prior.image].pose, r, j);
        });
    }
    for (const PosePrior& prior : priors_.poses) {
        add_pose(prior.image, num_pose_params);
        visit(prior, 6, 6, [&](const auto& images, const auto&, Residual& r, Block* j) {
            evaluate(prior, images[prior.image].pose, r, j);
        });
    }
    for (const IntrinsicsPrior& prior : priors_.intrinsics) {
        const int n = num_params_[prior.camera];
        add(intrinsics_offset_[prior.camera], n);
        visit(prior, n, max_camera_params,
              [&](const auto&, const auto& cameras, Residual& r, Block* j) {
                  for (int k = 0; k < n; ++k)
                      r[k] = cameras[prior.camera].params[k] - prior.params[k];
                  if (j) j->setIdentity();
              });
    }
    for (const RelativePosePrior& prior : priors_.relative_poses) {
        add_pose(prior.first, num_pose_params);
        add_pose(prior.second, num_pose_params);
        visit(prior, 6, 6, [&](const auto& images, const auto&, Residual& r, Block* j) {
            evaluate(prior, images[prior.first].pose, images[prior.second].pose, r, j);
        });
    }
}

ImagePriors::ImagePriors(const Problem& problem, const ParameterLayout& layout)
    : priors_(problem.priors),
      scale_(layout.scale),
      pose_offset_(layout.pose_offset),
      intrinsics_offset_(layout.intrinsics_offset),
      image_sensor_(layout.image_sensor) {
    for (const int32_t block : layout.sensor_block)
        sensor_offset_.push_back(block < 0 ? -1 : layout.blocks[block].offset);
    for (const Camera& camera : problem.cameras) num_params_.push_back(camera.num_params());
    list_pattern();
}

void ImagePriors::list_pattern() {
    std::vector<std::set<int32_t>> columns_of(scale_.size());
    for_each_term([&](const Term& term, auto&&) {
        for (int32_t row : term.scalars)
            for (int32_t column : term.scalars)
                if (row >= 0 && column >= 0) columns_of[row].insert(column);
    });
    row_begin_.push_back(0);
    for (size_t row = 0; row < columns_of.size(); ++row) {
        if (columns_of[row].empty()) continue;
        rows_.push_back(static_cast<int32_t>(row));
        columns_.insert(columns_.end(), columns_of[row].begin(), columns_of[row].end());
        row_begin_.push_back(static_cast<int32_t>(columns_.size()));
    }
}

double ImagePriors::cost(const std::vector<Image>& images,
                         const std::vector<Camera>& cameras) const {
    double sum = 0;
    for_each_term([&](const Term&, auto&& evaluate_term) {
        Residual r;
        evaluate_term(images, cameras, {}, r, nullptr);
        sum += 0.5 * r.squaredNorm();
    });
    return sum;
}

void ImagePriors::linearize(const std::vector<Image>& images, const std::vector<Camera>& cameras,
                            const std::vector<Pose>& sensors, std::vector<double>& gradient,
                            std::vector<double>& values) const {
    gradient.assign(scale_.size(), 0.0);
    values.assign(columns_.size(), 0.0);
    Residual r;
    Block j;
    for_each_term([&](const Term& term, auto&& evaluate_term) {
        evaluate_term(images, cameras, sensors, r, &j);
        const auto n = static_cast<Eigen::Index>(term.scalars.size());
        for (Eigen::Index a = 0; a < n; ++a) {
            const int32_t row = term.scalars[a];
            if (row < 0) continue;
            gradient[row] += j.col(a).dot(r);
            const auto at = std::lower_bound(rows_.begin(), rows_.end(), row) - rows_.begin();
            const auto begin = columns_.begin() + row_begin_[at];
            const auto end = columns_.begin() + row_begin_[at + 1];
            for (Eigen::Index b = 0; b < n; ++b) {
                if (term.scalars[b] < 0) continue;
                const auto entry = std::lower_bound(begin, end, term.scalars[b]);
                values[entry - columns_.begin()] += j.col(a).dot(j.col(b));
            }
        }
    });
}

void ImagePriors::for_each_row(const std::vector<Image>& images, const std::vector<Camera>& cameras,
                               const std::vector<Pose>& sensors, const VisitRow& visit) const {
    Residual r;
    Block j;
    for_each_term([&](const Term& term, auto&& evaluate_term) {
        evaluate_term(images, cameras, sensors, r, &j);
        for (Eigen::Index row = 0; row < r.size(); ++row)
            visit(r[row], static_cast<int>(j.cols()), term.scalars.data(), j.row(row).data());
    });
}

double prior_cost(const Problem& problem) {
    double sum = 0;
    if (problem.priors.has_image_side())
        sum = ImagePriors(problem, ParameterLayout(problem)).cost(problem.images, problem.cameras);
    for (const PointPrior& prior : problem.priors.points)
        sum += 0.5 * whitened(prior, problem.points[prior.point]).squaredNorm();
    return sum;
}

void add_information(const PointPrior& prior, double* v) {
    const Eigen::Map<const RowMajor3> whitening(prior.whitening.data());
    Eigen::Map<RowMajor3>(v) += whitening.transpose() * whitening;
}

}  // namespace clba::reference
