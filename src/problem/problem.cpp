// SPDX-License-Identifier: Apache-2.0
#include "problem/problem.hpp"

#include <algorithm>
#include <cmath>

#include "base/error.hpp"

namespace clba {
namespace {

void require_finite(double value, const char* array, int64_t row, const char* component) {
    require(std::isfinite(value), array, "[", row, "].", component, " = ", value,
            ", but it must be finite");
}

constexpr const char* axis_names[] = {"x", "y", "z"};

template <class Optional, class Rows>
void require_matching(const Optional& optional, const Rows& rows, const char* name,
                      const char* rows_name) {
    require(optional.empty() || optional.size() == rows.size(), name, " has ", optional.size(),
            " rows, but there are ", rows.size(), " ", rows_name);
}

template <class Values>
void require_positive(const std::vector<Values>& rows, const char* name) {
    for (size_t i = 0; i < rows.size(); ++i)
        for (size_t k = 0; k < rows[i].size(); ++k)
            require(std::isfinite(rows[i][k]) && rows[i][k] > 0, name, "[", i, "][", k,
                    "] = ", rows[i][k], ", but an uncertainty must be finite and > 0");
}

}  // namespace

uint8_t Problem::constants_of_image(int32_t image) const {
    if (rigs.has(image)) return rigs.constant_frames[rigs.image_frame[image]];
    return constant_images.empty() ? uint8_t{0} : constant_images[image];
}

void Problem::validate() const {
    for (size_t i = 0; i < cameras.size(); ++i) {
        const Camera& camera = cameras[i];
        require(is_camera_model(camera.model), "cameras[", i, "].model = ", camera.model,
                ", but the models are 0 to ", num_camera_models - 1);
        for (int k = 0; k < camera.num_params(); ++k)
            require(std::isfinite(camera.params[k]), "cameras[", i, "].params[", k,
                    "] = ", camera.params[k], ", but it must be finite");
    }
    for (size_t i = 0; i < images.size(); ++i) {
        const Image& image = images[i];
        require(image.camera >= 0 && image.camera < num_cameras(), "images[", i,
                "].camera = ", image.camera, ", but num_cameras = ", num_cameras());
        double norm = 0;
        for (double q : image.pose.rotation) {
            require_finite(q, "images", static_cast<int64_t>(i), "rotation");
            norm += q * q;
        }
        require(std::abs(norm - 1) < 1e-6, "images[", i, "].rotation has the squared norm ", norm,
                ", but a rotation is a unit quaternion");
        for (double t : image.pose.translation)
            require_finite(t, "images", static_cast<int64_t>(i), "translation");
    }
    for (size_t i = 0; i < points.size(); ++i)
        for (int k = 0; k < 3; ++k)
            require_finite(points[i][k], "points", static_cast<int64_t>(i), axis_names[k]);
    for (size_t i = 0; i < observations.size(); ++i) {
        const Observation& o = observations[i];
        require(o.image >= 0 && o.image < num_images(), "observations[", i, "].image = ", o.image,
                ", but num_images = ", num_images());
        require(o.point >= 0 && o.point < num_points(), "observations[", i, "].point = ", o.point,
                ", but num_points = ", num_points());
        require_finite(o.x, "observations", static_cast<int64_t>(i), "x");
        require_finite(o.y, "observations", static_cast<int64_t>(i), "y");
    }
    require_matching(whitening, observations, "covariances", "observations");
    require_matching(constant_images, images, "constant_images", "images");
    require_matching(constant_cameras, cameras, "constant_cameras", "cameras");
    require_matching(constant_points, points, "constant_points", "points");
    require_matching(image_uncertainties, images, "image_uncertainties", "images");
    require_matching(camera_uncertainties, cameras, "camera_uncertainties", "cameras");
    require_matching(point_uncertainties, points, "point_uncertainties", "points");
    require_positive(image_uncertainties, "image_uncertainties");
    require_positive(camera_uncertainties, "camera_uncertainties");
    require_positive(point_uncertainties, "point_uncertainties");
    for (size_t i = 0; i < whitening.size(); ++i)
        for (double value : whitening[i])
            require_finite(value, "covariances", static_cast<int64_t>(i), "factor");
    const auto require_index = [](int32_t index, int32_t count, const char* prior, size_t row,
                                  const char* counted) {
        require(index >= 0 && index < count, prior, "[", row, "] is of ", counted, " ", index,
                ", but there are ", count);
    };
    for (size_t i = 0; i < priors.positions.size(); ++i)
        require_index(priors.positions[i].image, num_images(), "priors.positions", i, "image");
    for (size_t i = 0; i < priors.poses.size(); ++i)
        require_index(priors.poses[i].image, num_images(), "priors.poses", i, "image");
    for (size_t i = 0; i < priors.intrinsics.size(); ++i)
        require_index(priors.intrinsics[i].camera, num_cameras(), "priors.intrinsics", i, "camera");
    for (size_t i = 0; i < priors.points.size(); ++i)
        require_index(priors.points[i].point, num_points(), "priors.points", i, "point");
    for (size_t i = 0; i < priors.relative_poses.size(); ++i)
        for (int32_t image : {priors.relative_poses[i].first, priors.relative_poses[i].second})
            require_index(image, num_images(), "priors.relative_poses", i, "image");
    require_valid(rigs, *this);
    require(std::isfinite(loss.scale) && loss.scale > 0, "loss scale = ", loss.scale,
            ", but it must be finite and > 0");
}

}  // namespace clba
