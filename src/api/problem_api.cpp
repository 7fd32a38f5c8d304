// SPDX-License-Identifier: Apache-2.0
// Problems: what they hold, generated scenes, comparison.
#include <cmath>
#include <limits>

#include "api/numbers.hpp"
#include "problem/parameter_layout.hpp"
#include "reference/compare.hpp"
#include "reference/scene.hpp"

namespace clba {
namespace {

// Drops what belongs to observations when images or points are replaced by another number of them.
void drop_observations(Problem& problem) {
    problem.observations.clear();
    problem.whitening.clear();
}

std::vector<Camera> read_cameras(int32_t count, const int32_t* models, size_t models_stride,
                                 const double* params, size_t params_stride) {
    require(count >= 0, "count = ", count, ", but it must be >= 0");
    const Rows model_rows(models, models_stride, 1, "models", count);
    std::vector<Camera> cameras(static_cast<size_t>(count));
    size_t most_params = 0;
    for (int32_t i = 0; i < count; ++i) {
        cameras[i].model = model_rows.get(i);
        require(is_camera_model(cameras[i].model), "models[", i, "] = ", cameras[i].model,
                ", but the models are 0 to ", num_camera_models - 1);
        most_params = std::max(most_params, static_cast<size_t>(cameras[i].num_params()));
    }
    if (count > 0) require_pointer(params, "params");
    require(params_stride == 0 || params_stride >= most_params * sizeof(double),
            "params has a stride of ", params_stride, " bytes, but a row has ",
            most_params * sizeof(double));
    const auto* row = reinterpret_cast<const unsigned char*>(params);
    for (int32_t i = 0; i < count; ++i) {
        const size_t bytes = static_cast<size_t>(cameras[i].num_params()) * sizeof(double);
        std::memcpy(cameras[i].params.data(), row, bytes);
        row += params_stride ? params_stride : bytes;
        for (int k = 0; k < cameras[i].num_params(); ++k)
            require(std::isfinite(cameras[i].params[k]), "params[", i, "][", k,
                    "] = ", cameras[i].params[k], ", but it must be finite");
    }
    return cameras;
}

std::vector<Image> read_images(const Problem& p, int32_t count, const int32_t* camera_indices,
                               size_t camera_stride, const double* poses, size_t poses_stride) {
    require(count >= 0, "count = ", count, ", but it must be >= 0");
    const Rows cameras(camera_indices, camera_stride, 1, "camera_indices", count);
    const Rows rows(poses, poses_stride, 7, "poses", count);
    std::vector<Image> images(static_cast<size_t>(count));
    for (int32_t i = 0; i < count; ++i) {
        Image& image = images[i];
        image.camera = cameras.get(i);
        require(image.camera >= 0 && image.camera < p.num_cameras(), "camera_indices[", i,
                "] = ", image.camera, ", but num_cameras = ", p.num_cameras());
        image.pose = read_pose(rows, i, "poses");
        image.pose.rotation = normalized(image.pose.rotation);
    }
    return images;
}

std::vector<Point> read_points(int32_t count, const double* xyz, size_t stride) {
    require(count >= 0, "count = ", count, ", but it must be >= 0");
    const Rows rows(xyz, stride, 3, "xyz", count);
    std::vector<Point> points(static_cast<size_t>(count));
    for (int32_t i = 0; i < count; ++i) points[i] = read_finite<3>(rows, i, "xyz");
    return points;
}

std::vector<Observation> read_observations(const Problem& p, int64_t count, const int32_t* images,
                                           size_t images_stride, const int32_t* points,
                                           size_t points_stride, const double* xy,
                                           size_t xy_stride) {
    require(count >= 0, "count = ", count, ", but it must be >= 0");
    const Rows image_rows(images, images_stride, 1, "images", count);
    const Rows point_rows(points, points_stride, 1, "points", count);
    const Rows xy_rows(xy, xy_stride, 2, "xy", count);
    std::vector<Observation> observations(static_cast<size_t>(count));
    for (int64_t i = 0; i < count; ++i) {
        Observation& o = observations[i];
        o = {image_rows.get(i), point_rows.get(i), xy_rows.get(i, 0), xy_rows.get(i, 1)};
        require(o.image >= 0 && o.image < p.num_images(), "images[", i, "] = ", o.image,
                ", but num_images = ", p.num_images());
        require(o.point >= 0 && o.point < p.num_points(), "points[", i, "] = ", o.point,
                ", but num_points = ", p.num_points());
        require(std::isfinite(o.x) && std::isfinite(o.y), "xy[", i, "] = (", o.x, ", ", o.y,
                "), but it must be finite");
    }
    return observations;
}

// As whitening.
std::vector<std::array<double, 3>> read_covariances(int64_t count, const double* covariances,
                                                    size_t stride) {
    const Rows rows(covariances, stride, 3, "covariances", count);
    std::vector<std::array<double, 3>> whitening(static_cast<size_t>(count));
    for (int64_t i = 0; i < count; ++i) {
        const double xx = rows.get(i, 0), xy = rows.get(i, 1), yy = rows.get(i, 2);
        // L = [l00, 0; l10, l11] and its inverse.
        const double l00 = std::sqrt(xx), l10 = xy / l00;
        const double rest = yy - l10 * l10;
        require(xx > 0 && rest > 0 && std::isfinite(xx + yy), "covariances[", i, "] = (", xx, ", ",
                xy, ", ", yy, "), but xx, xy, yy must make a positive definite matrix");
        const double l11 = std::sqrt(rest);
        whitening[i] = {1 / l00, -l10 / (l00 * l11), 1 / l11};
    }
    return whitening;
}

// Makes room for so many more rows, so that appending them cannot fail; amortised.
template <class Row>
void make_room(std::vector<Row>& rows, size_t count) {
    if (rows.capacity() - rows.size() < count)
        rows.reserve(std::max(2 * rows.capacity(), rows.size() + count));
}

template <class Row>
void append(const std::vector<Row>& from, std::vector<Row>& to) {
    to.insert(to.end(), from.begin(), from.end());
}

void require_room(int64_t present, int64_t count, const char* rows) {
    require(count <= std::numeric_limits<int32_t>::max() - present, "count = ", count,
            ", but with ", present, " ", rows, " there is room for ",
            std::numeric_limits<int32_t>::max() - present, " more");
}

// Rows of an optional array that has some.
template <class Row>
void make_optional_room(std::vector<Row>& rows, size_t count) {
    if (!rows.empty()) make_room(rows, count);
}
template <class Row>
void append_optional(std::vector<Row>& rows, size_t count, const Row& value) {
    if (!rows.empty()) rows.insert(rows.end(), count, value);
}

// A row of uncertainties.
template <class Row>
Row filled_with_ones(const std::vector<Row>&) {
    Row ones;
    ones.fill(1.0);
    return ones;
}

clba_scene_options default_scene_options() {
    const SceneOptions defaults;
    clba_scene_options options{};
    options.struct_size = sizeof options;
    options.scene = static_cast<int32_t>(defaults.kind);
    options.num_images = defaults.num_images;
    options.num_points = defaults.num_points;
    options.observations_per_image = defaults.observations_per_image;
    options.seed = defaults.seed;
    options.pixel_noise = defaults.pixel_noise;
    options.outlier_share = defaults.outlier_share;
    options.rotation_noise = defaults.rotation_noise;
    options.position_noise = defaults.position_noise;
    options.point_noise = defaults.point_noise;
    return options;
}

clba_problem* new_problem(Problem&& problem) {
    auto handle = std::make_unique<clba_problem>();
    handle->problem = std::move(problem);
    return handle.release();
}

}  // namespace
}  // namespace clba

using namespace clba;

int32_t clba_num_camera_models(void) {
    return num_camera_models;
}

const char* clba_camera_model_name(int32_t model) {
    return is_camera_model(model) ? camera_models[model].name : nullptr;
}

int32_t clba_camera_model_num_params(int32_t model) {
    return is_camera_model(model) ? camera_models[model].num_params : -1;
}

const char* clba_camera_model_param_names(int32_t model) {
    return is_camera_model(model) ? camera_models[model].param_names : nullptr;
}

clba_status clba_problem_create(clba_problem** problem) {
    if (problem) *problem = nullptr;
    return guarded([&] {
        require_pointer(problem, "problem");
        *problem = new_problem({});
    });
}

clba_status clba_problem_retain(clba_problem* problem) {
    return guarded([&] {
        require_pointer(problem, "problem");
        ++problem->references;
    });
}

void clba_problem_release(clba_problem* problem) {
    if (problem && --problem->references == 0) delete problem;
}

clba_status clba_problem_get_info(const clba_problem* problem, clba_problem_info* info) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Problem& p = problem->problem;
        const ParameterLayout layout(p);
        clba_problem_info out{};
        out.struct_size = sizeof out;
        out.num_cameras = p.num_cameras();
        out.num_images = p.num_images();
        out.num_points = p.num_points();
        out.num_observations = p.num_observations();
        out.num_parameters = layout.num_parameters(p);
        out.num_image_camera_parameters = layout.num_f;
        out.num_parameters_per_image_block = layout.max_image_columns;
        out.num_shared_cameras = layout.num_shared_cameras;
        out.num_frames = static_cast<int32_t>(p.rigs.frames.size());
        out.num_sensors = static_cast<int32_t>(p.rigs.sensors.size());
        copy_out(out, info, "info");
    });
}

clba_status clba_problem_set_cameras(clba_problem* problem, int32_t count, const int32_t* models,
                                     size_t models_stride, const double* params,
                                     size_t params_stride) {
    return changed(problem, [&](Problem& p) {
        std::vector<Camera> cameras =
            read_cameras(count, models, models_stride, params, params_stride);
        const bool is_same_number = cameras.size() == p.cameras.size();
        for (size_t i = 0; i < p.images.size(); ++i)
            require(is_same_number || p.images[i].camera < count, "images[", i,
                    "].camera = ", p.images[i].camera, ", but there would be ", count,
                    " cameras; set the images first, or set as many cameras as before");
        if (!is_same_number) {
            drop_observations(p);
            p.constant_cameras.clear();
            p.camera_uncertainties.clear();
        }
        const bool is_other_structure =
            !is_same_number ||
            !std::equal(cameras.begin(), cameras.end(), p.cameras.begin(),
                        [](const Camera& a, const Camera& b) { return a.model == b.model; });
        if (is_other_structure) p.priors.intrinsics.clear();
        p.cameras = std::move(cameras);
        return is_other_structure;
    });
}

clba_status clba_problem_set_images(clba_problem* problem, int32_t count,
                                    const int32_t* camera_indices, size_t camera_stride,
                                    const double* poses, size_t poses_stride) {
    return changed(problem, [&](Problem& p) {
        std::vector<Image> images =
            read_images(p, count, camera_indices, camera_stride, poses, poses_stride);
        if (images.size() == p.images.size()) {
            p.rigs.frames = frames_from_images(p.rigs, images);
            compose_images(p.rigs, images);
        } else {
            drop_observations(p);
            p.rigs = Rigs();
            p.constant_images.clear();
            p.image_uncertainties.clear();
            p.priors.positions.clear();
            p.priors.poses.clear();
            p.priors.relative_poses.clear();
        }
        const bool is_other_structure =
            !std::equal(images.begin(), images.end(), p.images.begin(), p.images.end(),
                        [](const Image& a, const Image& b) { return a.camera == b.camera; });
        p.images = std::move(images);
        return is_other_structure;
    });
}

clba_status clba_problem_set_points(clba_problem* problem, int32_t count, const double* xyz,
                                    size_t stride) {
    return changed(problem, [&](Problem& p) {
        std::vector<Point> points = read_points(count, xyz, stride);
        const bool is_other_structure = points.size() != p.points.size();
        if (is_other_structure) {
            drop_observations(p);
            p.constant_points.clear();
            p.point_uncertainties.clear();
            p.priors.points.clear();
        }
        p.points = std::move(points);
        return is_other_structure;
    });
}

clba_status clba_problem_set_observations(clba_problem* problem, int64_t count,
                                          const int32_t* images, size_t images_stride,
                                          const int32_t* points, size_t points_stride,
                                          const double* xy, size_t xy_stride) {
    return changed(problem, [&](Problem& p) {
        std::vector<Observation> observations = read_observations(
            p, count, images, images_stride, points, points_stride, xy, xy_stride);
        const bool is_same_structure =
            std::equal(observations.begin(), observations.end(), p.observations.begin(),
                       p.observations.end(), [](const Observation& a, const Observation& b) {
                           return a.image == b.image && a.point == b.point;
                       });
        p.observations = std::move(observations);
        p.whitening.clear();
        problem->reconstruction.observation_features.clear();
        problem->reconstruction.unmatched.clear();
        return is_same_structure ? Changed::measurements : Changed::structure;
    });
}

clba_status clba_problem_set_covariances(clba_problem* problem, int64_t count,
                                         const double* covariances, size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_observations(), "observations");
        p.whitening = read_covariances(count, covariances, stride);
        return Changed::measurements;
    });
}

clba_status clba_problem_set_sigmas(clba_problem* problem, int64_t count, const double* sigmas,
                                    size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_observations(), "observations");
        const Rows rows(sigmas, stride, 1, "sigmas", count);
        std::vector<std::array<double, 3>> whitening(static_cast<size_t>(count));
        for (int64_t i = 0; i < count; ++i) {
            const double sigma = rows.get(i);
            require(std::isfinite(sigma) && sigma > 0 && std::isfinite(1 / sigma), "sigmas[", i,
                    "] = ", sigma, ", but it must be finite and > 0");
            whitening[i] = {1 / sigma, 0, 1 / sigma};
        }
        p.whitening = std::move(whitening);
        return Changed::measurements;
    });
}

clba_status clba_problem_add_cameras(clba_problem* problem, int32_t count, const int32_t* models,
                                     size_t models_stride, const double* params,
                                     size_t params_stride) {
    return changed(problem, [&](Problem& p) {
        const std::vector<Camera> cameras =
            read_cameras(count, models, models_stride, params, params_stride);
        require_room(p.num_cameras(), count, "cameras");
        make_room(p.cameras, cameras.size());
        make_optional_room(p.constant_cameras, cameras.size());
        make_optional_room(p.camera_uncertainties, cameras.size());
        append(cameras, p.cameras);
        append_optional(p.constant_cameras, cameras.size(), uint32_t{0});
        append_optional(p.camera_uncertainties, cameras.size(),
                        filled_with_ones(p.camera_uncertainties));
        return Changed::rows_added;
    });
}

clba_status clba_problem_add_images(clba_problem* problem, int32_t count,
                                    const int32_t* camera_indices, size_t camera_stride,
                                    const double* poses, size_t poses_stride) {
    return changed(problem, [&](Problem& p) {
        const std::vector<Image> images =
            read_images(p, count, camera_indices, camera_stride, poses, poses_stride);
        require_room(p.num_images(), count, "images");
        make_room(p.images, images.size());
        make_optional_room(p.constant_images, images.size());
        make_optional_room(p.image_uncertainties, images.size());
        make_optional_room(p.rigs.image_frame, images.size());
        make_optional_room(p.rigs.image_sensor, images.size());
        append(images, p.images);
        append_optional(p.constant_images, images.size(), uint8_t{0});
        append_optional(p.image_uncertainties, images.size(),
                        filled_with_ones(p.image_uncertainties));
        append_optional(p.rigs.image_frame, images.size(), int32_t{-1});
        append_optional(p.rigs.image_sensor, images.size(), int32_t{-1});
        return Changed::rows_added;
    });
}

clba_status clba_problem_add_points(clba_problem* problem, int32_t count, const double* xyz,
                                    size_t stride) {
    return changed(problem, [&](Problem& p) {
        const std::vector<Point> points = read_points(count, xyz, stride);
        require_room(p.num_points(), count, "points");
        make_room(p.points, points.size());
        make_optional_room(p.constant_points, points.size());
        make_optional_room(p.point_uncertainties, points.size());
        append(points, p.points);
        append_optional(p.constant_points, points.size(), uint8_t{0});
        append_optional(p.point_uncertainties, points.size(),
                        filled_with_ones(p.point_uncertainties));
        return Changed::rows_added;
    });
}

clba_status clba_problem_add_observations(clba_problem* problem, int64_t count,
                                          const int32_t* images, size_t images_stride,
                                          const int32_t* points, size_t points_stride,
                                          const double* xy, size_t xy_stride,
                                          const double* covariances, size_t covariances_stride) {
    return changed(problem, [&](Problem& p) {
        const std::vector<Observation> observations = read_observations(
            p, count, images, images_stride, points, points_stride, xy, xy_stride);
        constexpr std::array<double, 3> identity{1, 0, 1};
        const bool is_whitened = covariances || !p.whitening.empty();
        std::vector<std::array<double, 3>> whitening;
        if (covariances)
            whitening = read_covariances(count, covariances, covariances_stride);
        else if (is_whitened)
            whitening.assign(observations.size(), identity);
        make_room(p.observations, observations.size());
        if (is_whitened)
            make_room(p.whitening, p.observations.size() - p.whitening.size() + whitening.size());
        if (is_whitened) p.whitening.resize(p.observations.size(), identity);
        append(observations, p.observations);
        append(whitening, p.whitening);
        return Changed::rows_added;
    });
}

clba_status clba_problem_get_cameras(const clba_problem* problem, int32_t first, int32_t count,
                                     int32_t* models, size_t models_stride, double* params,
                                     size_t params_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Problem& p = problem->problem;
        require_range(first, count, p.num_cameras(), "cameras");
        size_t most_params = 0;
        for (int32_t i = first; i < first + count; ++i)
            most_params = std::max(most_params, static_cast<size_t>(p.cameras[i].num_params()));
        require(params_stride == 0 || params_stride >= most_params * sizeof(double),
                "params has a stride of ", params_stride, " bytes, but a row has ",
                most_params * sizeof(double));
        auto* row = reinterpret_cast<unsigned char*>(params);
        for (int32_t i = first; i < first + count; ++i) {
            const Camera& camera = p.cameras[i];
            if (models)
                Rows(models, models_stride, 1, "models", count).set(i - first, 0, camera.model);
            if (!params) continue;
            const size_t bytes = static_cast<size_t>(camera.num_params()) * sizeof(double);
            std::memcpy(row, camera.params.data(), bytes);
            row += params_stride ? params_stride : bytes;
        }
    });
}

clba_status clba_problem_get_images(const clba_problem* problem, int32_t first, int32_t count,
                                    int32_t* camera_indices, size_t camera_stride, double* poses,
                                    size_t poses_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Problem& p = problem->problem;
        require_range(first, count, p.num_images(), "images");
        const Rows cameras(camera_indices, camera_stride, 1, "camera_indices", 0);
        const Rows rows(poses, poses_stride, 7, "poses", 0);
        for (int32_t i = 0; i < count; ++i) {
            const Image& image = p.images[first + i];
            if (camera_indices) cameras.set(i, 0, image.camera);
            if (poses) write_pose(image.pose, rows, i);
        }
    });
}

clba_status clba_problem_get_centers(const clba_problem* problem, int32_t first, int32_t count,
                                     double* centers, size_t stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Problem& p = problem->problem;
        require_range(first, count, p.num_images(), "images");
        const Rows rows(centers, stride, 3, "centers", count);
        for (int32_t i = 0; i < count; ++i) {
            const Point center = camera_center(p.images[first + i].pose);
            for (size_t k = 0; k < 3; ++k) rows.set(i, k, center[k]);
        }
    });
}

clba_status clba_problem_get_points(const clba_problem* problem, int32_t first, int32_t count,
                                    double* xyz, size_t stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Problem& p = problem->problem;
        require_range(first, count, p.num_points(), "points");
        const Rows rows(xyz, stride, 3, "xyz", count);
        for (int32_t i = 0; i < count; ++i)
            for (size_t k = 0; k < 3; ++k) rows.set(i, k, p.points[first + i][k]);
    });
}

clba_status clba_problem_get_observations(const clba_problem* problem, int64_t first, int64_t count,
                                          int32_t* images, size_t images_stride, int32_t* points,
                                          size_t points_stride, double* xy, size_t xy_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Problem& p = problem->problem;
        require_range(first, count, p.num_observations(), "observations");
        const Rows image_rows(images, images_stride, 1, "images", 0);
        const Rows point_rows(points, points_stride, 1, "points", 0);
        const Rows xy_rows(xy, xy_stride, 2, "xy", 0);
        for (int64_t i = 0; i < count; ++i) {
            const Observation& o = p.observations[first + i];
            if (images) image_rows.set(i, 0, o.image);
            if (points) point_rows.set(i, 0, o.point);
            if (!xy) continue;
            xy_rows.set(i, 0, o.x);
            xy_rows.set(i, 1, o.y);
        }
    });
}

clba_status clba_problem_set_constant_images(clba_problem* problem, int32_t count,
                                             const int32_t* flags, size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_images(), "images");
        const Rows rows(flags, stride, 1, "flags", count);
        std::vector<uint8_t> constant(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i) {
            const int32_t flag = rows.get(i);
            require((flag & ~int32_t{CLBA_CONSTANT_POSE}) == 0, "flags[", i, "] = ", flag,
                    ", but it is a sum of CLBA_CONSTANT_ROTATION (1) and CLBA_CONSTANT_POSITION "
                    "(2)");
            require(flag == 0 || !p.rigs.has(i), "flags[", i, "] = ", flag, ", but image ", i,
                    " is in a rig; hold its frame and its sensor by clba_problem_set_rigs");
            constant[i] = static_cast<uint8_t>(flag);
        }
        p.constant_images = std::move(constant);
        return Changed::scales;
    });
}

clba_status clba_problem_set_constant_cameras(clba_problem* problem, int32_t count,
                                              const int32_t* flags, size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_cameras(), "cameras");
        const Rows rows(flags, stride, 1, "flags", count);
        std::vector<uint32_t> constant(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i) {
            const int32_t flag = rows.get(i);
            require(flag >= 0 && flag >> p.cameras[i].num_params() == 0, "flags[", i, "] = ", flag,
                    ", but camera ", i, " has only ", p.cameras[i].num_params(), " parameters");
            constant[i] = static_cast<uint32_t>(flag);
        }
        p.constant_cameras = std::move(constant);
        return Changed::scales;
    });
}

clba_status clba_problem_set_constant_points(clba_problem* problem, int32_t count,
                                             const int32_t* flags, size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_points(), "points");
        const Rows rows(flags, stride, 1, "flags", count);
        std::vector<uint8_t> constant(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i) constant[i] = rows.get(i) != 0;
        p.constant_points = std::move(constant);
        return Changed::scales;
    });
}

namespace {

// constants: of a Problem, which has so many rows; empty: none.
template <class Constants>
clba_status get_constants(const clba_problem* problem, int32_t first, int32_t count, int32_t* flags,
                          size_t stride, int32_t (Problem::*num_rows)() const,
                          Constants Problem::*constants, const char* name) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Problem& p = problem->problem;
        require_range(first, count, (p.*num_rows)(), name);
        const Rows rows(flags, stride, 1, "flags", count);
        const Constants& all = p.*constants;
        for (int32_t i = 0; i < count; ++i)
            rows.set(i, 0, all.empty() ? 0 : static_cast<int32_t>(all[first + i]));
    });
}

}  // namespace

clba_status clba_problem_get_constant_images(const clba_problem* problem, int32_t first,
                                             int32_t count, int32_t* flags, size_t stride) {
    return get_constants(problem, first, count, flags, stride, &Problem::num_images,
                         &Problem::constant_images, "images");
}

clba_status clba_problem_get_constant_cameras(const clba_problem* problem, int32_t first,
                                              int32_t count, int32_t* flags, size_t stride) {
    return get_constants(problem, first, count, flags, stride, &Problem::num_cameras,
                         &Problem::constant_cameras, "cameras");
}

clba_status clba_problem_get_constant_points(const clba_problem* problem, int32_t first,
                                             int32_t count, int32_t* flags, size_t stride) {
    return get_constants(problem, first, count, flags, stride, &Problem::num_points,
                         &Problem::constant_points, "points");
}

namespace {

// Row `row` of rows, which is the caller's row i.
template <class Values>
void read_uncertainty(const Rows<const double>& rows, int64_t row, int64_t i, size_t width,
                      Values& out) {
    for (size_t k = 0; k < width; ++k) {
        out[k] = rows.get(row, k);
        require(std::isfinite(out[k]) && out[k] > 0, "values[", i, "][", k, "] = ", out[k],
                ", but an uncertainty must be finite and > 0");
    }
}

}  // namespace

clba_status clba_problem_set_image_uncertainties(clba_problem* problem, int32_t count,
                                                 const double* values, size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_images(), "images");
        const Rows rows(values, stride, num_pose_params, "values", count);
        std::vector<std::array<double, num_pose_params>> uncertainties(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i)
            read_uncertainty(rows, i, i, num_pose_params, uncertainties[i]);
        for (int32_t i = 0; i < count; ++i)
            for (int k = 0; k < num_pose_params && p.rigs.has(i); ++k)
                require(uncertainties[i][k] == 1, "values[", i, "][", k,
                        "] = ", uncertainties[i][k], ", but image ", i,
                        " is in a rig, where uncertainties are 1");
        p.image_uncertainties = std::move(uncertainties);
        return Changed::scales;
    });
}

clba_status clba_problem_set_camera_uncertainties(clba_problem* problem, int32_t count,
                                                  const double* values, size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_cameras(), "cameras");
        if (count != 0) require_pointer(values, "values");
        std::vector<std::array<double, max_camera_params>> uncertainties(
            static_cast<size_t>(count));
        const auto* row = reinterpret_cast<const unsigned char*>(values);
        for (int32_t i = 0; i < count; ++i) {
            const auto width = static_cast<size_t>(p.cameras[i].num_params());
            require(stride == 0 || stride >= width * sizeof(double), "values has a stride of ",
                    stride, " bytes, but row ", i, " has ", width * sizeof(double));
            uncertainties[i].fill(1.0);
            const Rows one(reinterpret_cast<const double*>(row), 0, width, "values", 1);
            read_uncertainty(one, 0, i, width, uncertainties[i]);
            row += stride ? stride : width * sizeof(double);
        }
        p.camera_uncertainties = std::move(uncertainties);
        return Changed::scales;
    });
}

clba_status clba_problem_set_point_uncertainties(clba_problem* problem, int32_t count,
                                                 const double* values, size_t stride) {
    return changed(problem, [&](Problem& p) {
        if (count != 0) require_count(count, p.num_points(), "points");
        const Rows rows(values, stride, 3, "values", count);
        std::vector<std::array<double, 3>> uncertainties(static_cast<size_t>(count));
        for (int32_t i = 0; i < count; ++i) read_uncertainty(rows, i, i, 3, uncertainties[i]);
        p.point_uncertainties = std::move(uncertainties);
        return Changed::scales;
    });
}

const char* clba_loss_name(int32_t loss) {
    static constexpr const char* names[] = {"none", "huber", "soft_l1", "cauchy", "tukey"};
    return loss >= CLBA_LOSS_NONE && loss <= CLBA_LOSS_TUKEY ? names[loss] : nullptr;
}

clba_status clba_problem_set_loss(clba_problem* problem, int32_t loss, double scale) {
    return changed(problem, [&](Problem& p) {
        require(clba_loss_name(loss) != nullptr, "loss = ", loss, ", but the losses are ",
                int{CLBA_LOSS_NONE}, " to ", int{CLBA_LOSS_TUKEY});
        const bool has_scale = loss != CLBA_LOSS_NONE;
        require(!has_scale || (std::isfinite(scale) && scale > 0), "scale = ", scale,
                ", but it must be finite and > 0");
        p.loss = {static_cast<LossKind>(loss), has_scale ? scale : 1.0};
        return false;
    });
}

clba_status clba_problem_get_offsets(const clba_problem* problem, int64_t* pose_offsets,
                                     int64_t* intrinsics_offsets) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const ParameterLayout layout(problem->problem);
        if (pose_offsets)
            std::copy(layout.pose_offset.begin(), layout.pose_offset.end(), pose_offsets);
        if (intrinsics_offsets)
            std::copy(layout.intrinsics_offset.begin(), layout.intrinsics_offset.end(),
                      intrinsics_offsets);
    });
}

clba_status clba_problem_apply_step(clba_problem* problem, const double* step) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(step, "step");
        const ParameterLayout layout(problem->problem);
        const int64_t n = layout.num_parameters(problem->problem);
        for (int64_t k = 0; k < n; ++k)
            require(std::isfinite(step[k]), "step[", k, "] = ", step[k], ", but it must be finite");
        apply_step(layout, step, problem->problem);
    });
}

clba_status clba_problem_compare(const clba_problem* a, const clba_problem* b,
                                 clba_comparison* comparison) {
    return guarded([&] {
        require_pointer(a, "a");
        require_pointer(b, "b");
        const Comparison internal = compare(a->problem, b->problem);
        clba_comparison out{};
        out.struct_size = sizeof out;
        out.scale = internal.scale;
        out.max_center_distance = internal.max_center_distance;
        out.median_center_distance = internal.median_center_distance;
        out.max_point_distance = internal.max_point_distance;
        out.median_point_distance = internal.median_point_distance;
        out.extent = internal.extent;
        copy_out(out, comparison, "comparison");
    });
}

const char* clba_scene_name(int32_t scene) {
    static constexpr const char* names[] = {"hall", "street", "landmark"};
    return scene >= CLBA_SCENE_HALL && scene <= CLBA_SCENE_LANDMARK ? names[scene - 1] : nullptr;
}

clba_status clba_scene_options_init(clba_scene_options* options, size_t struct_size) {
    return guarded([&] { init_struct(options, struct_size, default_scene_options(), "options"); });
}

clba_status clba_problem_generate(const clba_scene_options* options, clba_problem** start,
                                  clba_problem** truth) {
    if (start) *start = nullptr;
    if (truth) *truth = nullptr;
    return guarded([&] {
        require_pointer(start, "start");
        const clba_scene_options given = copied_in(options, default_scene_options(), "options");
        require(clba_scene_name(given.scene) != nullptr, "scene = ", given.scene,
                ", but the scenes are ", int{CLBA_SCENE_HALL}, " to ", int{CLBA_SCENE_LANDMARK});
        require(given.reserved == 0, "reserved = ", given.reserved, ", but it must be 0");
        SceneOptions internal;
        internal.kind = static_cast<SceneKind>(given.scene);
        internal.num_images = given.num_images;
        internal.num_points = given.num_points;
        internal.observations_per_image = given.observations_per_image;
        internal.seed = given.seed;
        internal.pixel_noise = given.pixel_noise;
        internal.outlier_share = given.outlier_share;
        internal.rotation_noise = given.rotation_noise;
        internal.position_noise = given.position_noise;
        internal.point_noise = given.point_noise;
        Scene scene = generate_scene(internal);
        std::unique_ptr<clba_problem> made_truth;
        if (truth) made_truth.reset(new_problem(std::move(scene.truth)));
        *start = new_problem(std::move(scene.start));
        if (truth) *truth = made_truth.release();
    });
}
