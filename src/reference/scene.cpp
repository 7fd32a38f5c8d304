// SPDX-License-Identifier: Apache-2.0
#include "reference/scene.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "base/error.hpp"
#include "reference/scene_places.hpp"
#include "reference/scene_tracks.hpp"

namespace clba {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using scene::least_observations;
using scene::Place;
using scene::Random;
using scene::Tracks;
using scene::View;

enum Stream : uint64_t {
    stream_views = 1,
    stream_tracks = 2,
    stream_pixels = 3,
    stream_outliers = 4,
    stream_start = 5
};

Point to_point(const Vector3d& v) {
    return {v.x(), v.y(), v.z()};
}

Pose pose_of(const std::array<double, 4>& rotation, const Vector3d& center) {
    const auto matrix = rotation_matrix(rotation);
    const Vector3d t =
        -(Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(matrix.data()) * center);
    return {rotation, to_point(t)};
}

std::vector<Observation> observe(const std::vector<View>& views, const Tracks& tracks,
                                 const SceneOptions& options) {
    Random pixels(options.seed, stream_pixels), outliers(options.seed, stream_outliers);
    std::vector<Observation> observations;
    observations.reserve(tracks.images.size());
    for (int32_t p = 0; p < tracks.num_points(); ++p) {
        for (int64_t i = tracks.begin[p]; i < tracks.begin[p + 1]; ++i) {
            const int32_t image = tracks.images[static_cast<size_t>(i)];
            const Vector2d pixel = views[image].project(tracks.points[p].position);
            Observation o{image, p, 0, 0};
            o.x = pixel.x() + options.pixel_noise * pixels.normal();
            o.y = pixel.y() + options.pixel_noise * pixels.normal();
            if (outliers.uniform() < options.outlier_share) {
                o.x = outliers.uniform(-scene::half_width, scene::half_width);
                o.y = outliers.uniform(-scene::half_height, scene::half_height);
            }
            observations.push_back(o);
        }
    }
    return observations;
}

Problem true_problem(const std::vector<View>& views, const Tracks& tracks,
                     const SceneOptions& options) {
    Problem truth;
    for (const View& view : views) {
        const Eigen::Quaterniond q(view.rotation);
        const auto rotation = normalized({q.w(), q.x(), q.y(), q.z()});
        truth.images.push_back({truth.num_cameras(), pose_of(rotation, view.center)});
        Camera camera;
        camera.model = camera_snavely;
        camera.params[0] = view.f;
        camera.params[1] = view.k1;
        camera.params[2] = view.k2;
        truth.cameras.push_back(camera);
    }
    truth.points.reserve(tracks.points.size());
    for (const scene::SurfacePoint& point : tracks.points)
        truth.points.push_back(to_point(point.position));
    truth.observations = observe(views, tracks, options);
    return truth;
}

double mean_depth(const std::vector<View>& views, const Tracks& tracks) {
    double sum = 0;
    for (int32_t p = 0; p < tracks.num_points(); ++p)
        for (int64_t i = tracks.begin[p]; i < tracks.begin[p + 1]; ++i)
            sum += views[tracks.images[static_cast<size_t>(i)]].depth(tracks.points[p].position);
    return tracks.images.empty() ? 0 : sum / static_cast<double>(tracks.images.size());
}

// Displacement of each image's surroundings: the integral along the path of an error of direction
// and scale that changes slowly (first-order autoregressive); 0 at both ends of a closed path.
std::vector<Vector3d> draw_drift(const Place& place, const std::vector<View>& views, double share,
                                 Random& random) {
    const size_t count = views.size();
    std::vector<Vector3d> drift(count, Vector3d::Zero());
    if (!place.is_path()) return drift;
    constexpr double correlation_images = 50;
    const double kept = std::exp(-1 / correlation_images);
    Vector3d rate = random.normal_vector();
    for (size_t i = 1; i < count; ++i) {
        const double way = (views[i].center - views[i - 1].center).norm();
        drift[i] = drift[i - 1] + share * way * rate;
        rate = kept * rate + std::sqrt(1 - kept * kept) * random.normal_vector();
    }
    if (place.is_closed()) {
        const Vector3d gap = drift.back();
        for (size_t i = 0; i < count; ++i)
            drift[i] -= static_cast<double>(i) / static_cast<double>(count - 1) * gap;
    }
    return drift;
}

Problem disturbed(const Problem& truth, const Place& place, const std::vector<View>& views,
                  const Tracks& tracks, const SceneOptions& options) {
    constexpr double focal_noise = 0.01;
    Random random(options.seed, stream_start);
    const double depth = mean_depth(views, tracks);
    const auto drift = draw_drift(place, views, options.position_noise, random);
    Problem start = truth;
    for (size_t i = 0; i < views.size(); ++i) {
        const Vector3d turn =
            options.rotation_noise * scene::radians_per_degree * random.normal_vector();
        const Vector3d moved =
            views[i].center + drift[i] + options.position_noise * depth * random.normal_vector();
        const auto rotation = normalized(quaternion_product(
            quaternion_from_rotation_vector(to_point(turn)), truth.images[i].pose.rotation));
        start.images[i].pose = pose_of(rotation, moved);
        start.cameras[i].params[0] *= 1 + focal_noise * random.normal();
        start.cameras[i].params[1] = 0;
        start.cameras[i].params[2] = 0;
    }
    for (size_t p = 0; p < tracks.points.size(); ++p) {
        const Vector3d moved = tracks.points[p].position + drift[tracks.anchors[p]] +
                               options.point_noise * depth * random.normal_vector();
        start.points[p] = to_point(moved);
    }
    return start;
}

void require_not_negative(double value, const char* name) {
    require(std::isfinite(value) && value >= 0, name, " = ", value,
            ", but it must be finite and >= 0");
}

void validate(const SceneOptions& options) {
    const int kind = static_cast<int>(options.kind);
    require(kind >= 1 && kind <= 3, "scene = ", kind,
            ", but the scenes are 1 (hall), 2 (street) and 3 (landmark)");
    require(options.num_images >= 2, "num_images = ", options.num_images, ", but it must be >= 2");
    require(options.num_points >= 0, "num_points = ", options.num_points,
            ", but it must be >= 1, or 0 to follow from the observations");
    require(options.observations_per_image >= least_observations,
            "observations_per_image = ", options.observations_per_image,
            ", but it must be >= ", least_observations);
    require(options.outlier_share >= 0 && options.outlier_share <= 1,
            "outlier_share = ", options.outlier_share, ", but it must be from 0 to 1");
    require_not_negative(options.pixel_noise, "pixel_noise");
    require_not_negative(options.rotation_noise, "rotation_noise");
    require_not_negative(options.position_noise, "position_noise");
    require_not_negative(options.point_noise, "point_noise");
}

}  // namespace

Scene generate_scene(const SceneOptions& options) {
    validate(options);
    const double num_observations =
        static_cast<double>(options.num_images) * options.observations_per_image;
    // Tracks of 5 where there are enough images for them.
    const double usual_length = std::min(5.0, 1 + 0.5 * options.num_images);
    const double num_points =
        options.num_points > 0 ? options.num_points : std::round(num_observations / usual_length);
    require(num_points <= std::numeric_limits<int32_t>::max(), "num_images = ", options.num_images,
            " with observations_per_image = ", options.observations_per_image, " need ", num_points,
            " points, but there can be 2147483647; give num_points");

    const double mean_length =
        std::clamp(num_observations / num_points, 2.0, 1.0 * options.num_images);
    Random random(options.seed, stream_views);
    const auto place = scene::make_place(options, mean_length, random);
    std::vector<View> views;
    for (int32_t i = 0; i < options.num_images; ++i) views.push_back(place->make_view(i, random));
    Random track_random(options.seed, stream_tracks);
    const Tracks tracks = scene::make_tracks(*place, views, static_cast<int64_t>(num_points),
                                             mean_length, track_random);

    Scene result;
    result.truth = true_problem(views, tracks, options);
    result.start = disturbed(result.truth, *place, views, tracks, options);
    return result;
}

}  // namespace clba
