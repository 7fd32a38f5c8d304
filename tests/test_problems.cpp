// SPDX-License-Identifier: Apache-2.0
#include "test_problems.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <set>
#include <string>

#include "reference/camera_models.hpp"

namespace clba::test {
namespace {

// The distributions of the standard library differ between its makers; these do not.
class Random {
public:
    explicit Random(uint64_t seed) : engine_(seed) {}
    double uniform(double low, double high) {
        return low + (high - low) * static_cast<double>(engine_() >> 11) * 0x1p-53;
    }
    double normal() {  // Box and Muller
        const double radius = std::sqrt(-2 * std::log(1 - uniform(0, 1)));
        return radius * std::cos(uniform(0, 6.283185307179586));
    }
    size_t below(size_t bound) { return static_cast<size_t>(engine_() % bound); }
    template <class Value>
    void shuffle(std::vector<Value>& values) {
        for (size_t k = values.size(); k > 1; --k) std::swap(values[k - 1], values[below(k)]);
    }
    Eigen::Vector3d direction() {
        Eigen::Vector3d direction;
        for (double& coordinate : direction) coordinate = normal();
        return direction.normalized();
    }

private:
    std::mt19937_64 engine_;
};

// Reads the parameters' meaning from their names, so that a new model gets a scene too.
Camera plausible_camera(int32_t model, Random& random) {
    Camera camera;
    camera.model = model;
    std::string names = std::string(camera_models[model].param_names) + ",";
    for (int k = 0; k < camera.num_params(); ++k) {
        const std::string name = names.substr(0, names.find(','));
        names.erase(0, name.size() + 1);
        double& value = camera.params[k];
        if (name[0] == 'f')
            value = random.uniform(780, 820);
        else if (name[0] == 'c')
            value = random.uniform(380, 520);
        else if (name[0] == 'p' || name[0] == 's')
            value = random.uniform(-2e-3, 2e-3);
        else if (name == "omega")
            value = random.uniform(0.7, 1.1);
        else
            value = name == "k" || name == "k1" ? random.uniform(-0.12, -0.08)
                                                : random.uniform(0.01, 0.03);
    }
    return camera;
}

Pose looking_at_origin(const Eigen::Vector3d& center, const Eigen::Vector3d& up, int front_sign) {
    Eigen::Matrix3d rotation;  // rows: the camera's axes in the world
    rotation.row(2) = -front_sign * center.normalized();
    rotation.row(0) = up.cross(rotation.row(2)).normalized();
    rotation.row(1) = rotation.row(2).cross(rotation.row(0));
    const Eigen::Quaterniond q(rotation);
    const Eigen::Vector3d t = -rotation * center;
    return {{q.w(), q.x(), q.y(), q.z()}, {t.x(), t.y(), t.z()}};
}

int front_sign(int32_t model) {
    return reference::with_camera_model(model,
                                        [](auto camera) { return decltype(camera)::front_sign; });
}

Point random_point_in_ball(Random& random) {
    const double radius = std::cbrt(random.uniform(0, 1));
    const Eigen::Vector3d p = radius * random.direction();
    return {p.x(), p.y(), p.z()};
}

Eigen::Vector3d in_camera_frame(const Problem& problem, int32_t image, int32_t point) {
    const auto r = rotation_matrix(problem.images[image].pose.rotation);
    const auto& t = problem.images[image].pose.translation;
    const Point& x = problem.points[point];
    Eigen::Vector3d p;
    for (int k = 0; k < 3; ++k)
        p[k] = r[3 * k] * x[0] + r[3 * k + 1] * x[1] + r[3 * k + 2] * x[2] + t[k];
    return p;
}

void observe(Problem& problem, int32_t image, int32_t point, Random& random, double noise = 0.5) {
    const Eigen::Vector3d p = in_camera_frame(problem, image, point);
    const auto pixel = reference::project(problem.cameras[problem.images[image].camera], p).pixel;
    problem.observations.push_back(
        {image, point, pixel.x() + noise * random.normal(), pixel.y() + noise * random.normal()});
}

void observe_random_share(Problem& problem, double share, Random& random) {
    const auto num_points = problem.points.size();
    std::vector<std::vector<int32_t>> images_without(num_points);
    std::vector<int> num_observations(num_points, 0);
    std::vector<int32_t> order(num_points);
    std::iota(order.begin(), order.end(), 0);
    const auto num_seen = static_cast<size_t>(std::lround(share * static_cast<double>(num_points)));
    for (int32_t image = 0; image < problem.num_images(); ++image) {
        random.shuffle(order);
        for (size_t k = 0; k < num_points; ++k) {
            if (k >= num_seen) {
                images_without[order[k]].push_back(image);
                continue;
            }
            observe(problem, image, order[k], random);
            ++num_observations[order[k]];
        }
    }
    const int wanted = std::min(2, problem.num_images());
    for (int32_t point = 0; point < problem.num_points(); ++point) {
        random.shuffle(images_without[point]);
        for (int k = 0; k < wanted - num_observations[point]; ++k)
            observe(problem, images_without[point][k], point, random);
    }
    random.shuffle(problem.observations);
}

void disturb(Problem& problem, Random& random) {
    const ParameterLayout layout(problem);
    std::vector<double> step(static_cast<size_t>(layout.num_parameters(problem)));
    for (double& value : step) value = 0.01 * random.normal();
    for (int32_t camera = 0; camera < problem.num_cameras(); ++camera)
        for (int k = 0; k < problem.cameras[camera].num_params(); ++k)
            step[layout.intrinsics_offset[camera] + k] *= 0.1 * problem.cameras[camera].params[k];
    apply_step(layout, step.data(), problem);
}

Problem scene(const std::vector<int32_t>& camera_of_image, const std::vector<int32_t>& models,
              int num_points, uint64_t seed) {
    Random random(seed);
    Problem problem;
    for (int32_t model : models) problem.cameras.push_back(plausible_camera(model, random));
    for (int32_t camera : camera_of_image) {
        const double distance = random.uniform(4.5, 5.5);
        const Eigen::Vector3d center = distance * random.direction();
        problem.images.push_back(
            {camera, looking_at_origin(center, random.direction(), front_sign(models[camera]))});
    }
    for (int k = 0; k < num_points; ++k) problem.points.push_back(random_point_in_ball(random));
    observe_random_share(problem, 0.6, random);
    disturb(problem, random);
    problem.validate();
    return problem;
}

}  // namespace

std::vector<int32_t> all_camera_models() {
    std::vector<int32_t> models(num_camera_models);
    std::iota(models.begin(), models.end(), 0);
    return models;
}

Problem small_scene(int num_images, int num_points, const std::vector<int32_t>& models,
                    bool shared_cameras, uint64_t seed) {
    const int num_cameras =
        shared_cameras ? std::max(1, std::min(static_cast<int>(models.size()), num_images / 2))
                       : num_images;
    std::vector<int32_t> camera_of_image, model_of_camera;
    for (int i = 0; i < num_images; ++i) camera_of_image.push_back(i % num_cameras);
    for (int c = 0; c < num_cameras; ++c)
        model_of_camera.push_back(models[static_cast<size_t>(c) % models.size()]);
    return scene(camera_of_image, model_of_camera, num_points, seed);
}

Problem mixed_scene(int num_images, int num_points, uint64_t seed) {
    std::vector<int32_t> camera_of_image;
    for (int i = 0; i < num_images; ++i) camera_of_image.push_back(std::min(i, 2));
    return scene(camera_of_image, {camera_snavely, camera_opencv, camera_snavely}, num_points,
                 seed);
}

Problem rig_scene(int num_frames, int num_points, uint64_t seed) {
    Random random(seed);
    Problem problem;
    for (const int32_t model :
         {camera_opencv, camera_opencv, camera_opencv, camera_opencv, camera_snavely})
        problem.cameras.push_back(plausible_camera(model, random));
    Rigs& rigs = problem.rigs;
    for (int s = 0; s < 3; ++s) {
        Pose sensor;
        if (s > 0) {
            sensor.rotation = quaternion_from_rotation_vector(
                {random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), random.uniform(-1, 1)});
            for (double& t : sensor.translation) t = random.uniform(-0.5, 0.5);
        }
        rigs.sensors.push_back(sensor);
        rigs.constant_sensors.push_back(s == 0 ? constant_rotation | constant_position : 0);
    }
    const auto pose = [&](int32_t model = camera_opencv) {
        const double distance = random.uniform(4.5, 5.5);
        return looking_at_origin(distance * random.direction(), random.direction(),
                                 front_sign(model));
    };
    const auto add_image = [&](int32_t camera, int32_t sensor) {
        problem.images.push_back({camera, Pose()});
        rigs.image_frame.push_back(static_cast<int32_t>(rigs.frames.size()) - 1);
        rigs.image_sensor.push_back(sensor);
    };
    for (int f = 0; f < num_frames; ++f) {
        rigs.frames.push_back(pose());
        for (int32_t s = 0; s < 3; ++s) add_image(f == 0 && s == 2 ? 3 : s, s);
    }
    for (const int32_t sensor : {1, 0}) {
        rigs.frames.push_back(pose());
        add_image(sensor, sensor);
    }
    rigs.constant_frames.assign(rigs.frames.size(), 0);
    compose_images(rigs, problem.images);
    for (const int32_t camera : {4, 1}) {
        problem.images.push_back({camera, pose(problem.cameras[camera].model)});
        rigs.image_frame.push_back(-1);
        rigs.image_sensor.push_back(-1);
    }
    for (int k = 0; k < num_points; ++k) problem.points.push_back(random_point_in_ball(random));
    observe_random_share(problem, 0.6, random);
    disturb(problem, random);
    problem.validate();
    return problem;
}

Problem wide_angle_scene() {
    Random random(32);
    Problem problem;
    for (int32_t model : all_camera_models())
        problem.cameras.push_back(plausible_camera(model, random));
    for (double omega : {0.0, 1e-9, 1e-3, 1.99, 2.01, 2.8}) {
        problem.cameras.push_back(plausible_camera(camera_fov, random));
        problem.cameras.back().params[4] = omega;
    }
    for (int32_t camera = 0; camera < problem.num_cameras(); ++camera) {
        // Half a turn about x where the camera looks along -z.
        const bool is_turned = front_sign(problem.cameras[camera].model) < 0;
        problem.images.push_back(
            {camera, {{is_turned ? 0.0 : 1.0, is_turned ? 1.0 : 0.0, 0, 0}, {0, 0, 0}}});
    }
    problem.points = {{0, 0, 5}, {5e-9, 0, 5}, {0, -5e-9, 5}, {3e-5, 4e-5, 5}, {0.3, 0.4, -5}};
    for (double degrees : {5.0, 13.0, 14.1, 30.0, 60.0, 80.0}) {
        for (int k = 0; k < 4; ++k) {
            const double around = random.uniform(0, 6.28), depth = random.uniform(1, 5);
            const double r = depth * std::tan(degrees * 0.017453292519943295);
            problem.points.push_back({r * std::cos(around), r * std::sin(around), depth});
        }
    }
    for (int32_t image = 0; image < problem.num_images(); ++image)
        for (int32_t point = 0; point < problem.num_points(); ++point)
            observe(problem, image, point, random);
    problem.validate();
    return problem;
}

Recoverable recoverable_scene() {
    Random random(33);
    Problem problem;
    for (bool is_shared : {false, true}) {
        for (int32_t model : all_camera_models()) {
            const int32_t camera = problem.num_cameras();
            problem.cameras.push_back(plausible_camera(model, random));
            for (int k = 0; k < (is_shared ? 2 : 1); ++k) {
                const Eigen::Vector3d center = random.uniform(1, 2) * random.direction();
                problem.images.push_back(
                    {camera, looking_at_origin(center, random.direction(), front_sign(model))});
            }
        }
    }
    for (int k = 0; k < 400; ++k) {
        const Eigen::Vector3d p = random.uniform(4, 6) * random.direction();
        problem.points.push_back({p.x(), p.y(), p.z()});
    }
    const double cosine_of_edge = 0.5;
    for (int32_t image = 0; image < problem.num_images(); ++image) {
        const int sign = front_sign(problem.cameras[problem.images[image].camera].model);
        for (int32_t point = 0; point < problem.num_points(); ++point) {
            const Eigen::Vector3d p = in_camera_frame(problem, image, point);
            if (sign * p.z() > cosine_of_edge * p.norm()) observe(problem, image, point, random, 0);
        }
    }
    Recoverable scene{problem, problem};
    disturb(scene.start, random);
    scene.start.validate();
    return scene;
}

Problem with_widest_camera(Problem problem) {
    Camera camera;
    while (camera.num_params() < max_camera_params) ++camera.model;
    problem.cameras.push_back(camera);
    return problem;
}

Problem with_covariances(Problem problem, uint64_t seed) {
    Random random(seed);
    for (size_t i = 0; i < problem.observations.size(); ++i)
        problem.whitening.push_back(
            {random.uniform(0.5, 2), random.uniform(-0.5, 0.5), random.uniform(0.5, 2)});
    return problem;
}

Problem with_loss(Problem problem, LossKind kind, double scale) {
    problem.loss = {kind, scale};
    return problem;
}

Problem with_constants(Problem problem) {
    constexpr uint8_t flags[] = {constant_rotation | constant_position, constant_rotation,
                                 constant_position};
    problem.constant_images.assign(problem.images.size(), 0);
    for (size_t i = 0; i < std::min<size_t>(3, problem.images.size()); ++i)
        problem.constant_images[i] = flags[i];
    problem.constant_cameras.assign(problem.cameras.size(), 0);
    if (!problem.cameras.empty()) {
        problem.constant_cameras.front() = 1;
        problem.constant_cameras.back() = (1u << problem.cameras.back().num_params()) - 1;
    }
    problem.constant_points.assign(problem.points.size(), 0);
    for (size_t p = 0; p < problem.points.size(); p += 5) problem.constant_points[p] = 1;
    return problem;
}

Problem with_uncertainties(Problem problem, uint64_t seed) {
    Random random(seed);
    const auto fill = [&](auto& rows, size_t count) {
        rows.resize(count);
        for (auto& row : rows)
            for (double& value : row) value = std::pow(10, random.uniform(-1, 1));
    };
    fill(problem.image_uncertainties, problem.images.size());
    fill(problem.camera_uncertainties, problem.cameras.size());
    fill(problem.point_uncertainties, problem.points.size());
    return problem;
}

namespace {

// L^-1 of a random covariance: n x n in rows of `stride` numbers.
template <class Sigmas, class Whitening>
void fill_whitening(Random& random, int n, int stride, const Sigmas& sigmas, Whitening& whitening) {
    for (int r = 0; r < n; ++r)
        for (int c = 0; c <= r; ++c)
            whitening[r * stride + c] =
                (r == c ? random.uniform(0.7, 1.3) : random.uniform(-0.5, 0.5)) / sigmas[c];
}

Pose disturbed(const Pose& pose, double rotation, double position, Random& random) {
    std::array<double, 3> w;
    for (double& x : w) x = random.uniform(-rotation, rotation);
    Pose result = pose;
    result.rotation = quaternion_product(quaternion_from_rotation_vector(w), pose.rotation);
    for (double& t : result.translation) t += random.uniform(-position, position);
    return result;
}

// Second camera from first camera.
Pose relative_pose(const Pose& first, const Pose& second) {
    const auto& q = first.rotation;
    Pose relative;
    relative.rotation = quaternion_product(second.rotation, {q[0], -q[1], -q[2], -q[3]});
    const auto r = rotation_matrix(relative.rotation);
    for (int k = 0; k < 3; ++k)
        relative.translation[k] = second.translation[k] - (r[3 * k] * first.translation[0] +
                                                           r[3 * k + 1] * first.translation[1] +
                                                           r[3 * k + 2] * first.translation[2]);
    return relative;
}

}  // namespace

Problem with_priors(Problem problem, uint64_t seed) {
    Random random(seed);
    constexpr std::array<double, 3> of_position = {0.01, 0.02, 0.05};
    constexpr std::array<double, 6> of_pose = {0.01, 0.02, 0.005, 0.03, 0.01, 0.02};
    Priors& priors = problem.priors;
    const auto near = [&](const Point& at) {
        Point result = at;
        for (double& x : result) x += random.uniform(-0.1, 0.1);
        return result;
    };
    const int32_t n = problem.num_images();
    for (int32_t i = 0; i < n; i += 2) {
        priors.positions.push_back({i, near(camera_center(problem.images[i].pose)), {}});
        fill_whitening(random, 3, 3, of_position, priors.positions.back().whitening);
    }
    for (int32_t i = 1; i < std::min(n, 3); ++i) {
        priors.poses.push_back({i, disturbed(problem.images[i].pose, 0.05, 0.05, random), {}});
        fill_whitening(random, 6, 6, of_pose, priors.poses.back().whitening);
    }
    for (int32_t c : std::set<int32_t>{0, problem.num_cameras() - 1}) {
        IntrinsicsPrior prior;
        prior.camera = c;
        const int count = problem.cameras[c].num_params();
        std::array<double, max_camera_params> sigmas;
        for (int k = 0; k < count; ++k) {
            prior.params[k] = problem.cameras[c].params[k];
            sigmas[k] = 0.01 * std::max(std::abs(prior.params[k]), 0.01);
            prior.params[k] += random.uniform(-3, 3) * sigmas[k];
        }
        fill_whitening(random, count, max_camera_params, sigmas, prior.whitening);
        for (int k = 0; k < count; ++k)
            prior.whitening[max_camera_params + k] = prior.whitening[max_camera_params * k + 1] = 0;
        priors.intrinsics.push_back(prior);
    }
    for (int32_t p = 1; p < problem.num_points(); p += 4) {
        priors.points.push_back({p, near(problem.points[p]), {}});
        fill_whitening(random, 3, 3, of_position, priors.points.back().whitening);
    }
    const std::array<int32_t, 2> pairs[] = {{0, 3}, {0, 3}, {4, 1}, {n - 1, 0}};
    for (const auto& [first, second] : pairs) {
        if (first >= n || second >= n || first == second) continue;
        const Pose relative =
            relative_pose(problem.images[first].pose, problem.images[second].pose);
        priors.relative_poses.push_back(
            {first, second, disturbed(relative, 0.05, 0.05, random), {}});
        fill_whitening(random, 6, 6, of_pose, priors.relative_poses.back().whitening);
    }
    problem.validate();
    return problem;
}

Problem shifted(Problem problem, double offset) {
    for (Image& image : problem.images) {
        const auto r = rotation_matrix(image.pose.rotation);
        for (int k = 0; k < 3; ++k)
            image.pose.translation[k] -= (r[3 * k] + r[3 * k + 1] + r[3 * k + 2]) * offset;
    }
    for (Point& point : problem.points)
        for (double& coordinate : point) coordinate += offset;
    return problem;
}

Problem scaled(Problem problem, double factor) {
    for (Image& image : problem.images)
        for (double& coordinate : image.pose.translation) coordinate *= factor;
    for (Point& point : problem.points)
        for (double& coordinate : point) coordinate *= factor;
    return problem;
}

Problem planted_trouble() {
    Random random(31);
    Problem problem;
    for (int32_t model :
         {camera_snavely, camera_radial, camera_opencv, camera_snavely, camera_pinhole})
        problem.cameras.push_back(plausible_camera(model, random));
    const Eigen::Vector3d up(0.1, 1, 0.2);
    problem.images = {{0, {{1, 0, 0, 0}, {0, 0, -5}}},
                      {1, looking_at_origin({4, 1, -3}, up, 1)},
                      {1, looking_at_origin({-4, 0.5, -3}, up, 1)},
                      {2, looking_at_origin({0.5, 4, -3}, up, 1)},
                      {3, looking_at_origin({3, -3, 2}, up, -1)}};
    for (int k = 0; k < 10; ++k) problem.points.push_back(random_point_in_ball(random));
    for (int32_t image = 0; image < 4; ++image)
        for (int32_t point = 0; point < 10; ++point) observe(problem, image, point, random);
    problem.points.push_back({0.3, 0.2, 6});
    problem.points.push_back({0, 0, 5});
    problem.points.push_back({1, 0.5, 5});
    problem.points.push_back(random_point_in_ball(random));
    problem.points.push_back(random_point_in_ball(random));
    for (int32_t point : {10, 11, 12})
        for (int32_t image : {0, 1, 2}) observe(problem, image, point, random);
    observe(problem, 3, 13, random);
    observe(problem, 1, 0, random);
    problem.validate();
    return problem;
}

std::vector<double> random_vector(int64_t size, uint64_t seed) {
    Random random(seed);
    std::vector<double> values(static_cast<size_t>(size));
    for (double& value : values) value = random.uniform(-1, 1);
    return values;
}

Eigen::MatrixXd dense(const Problem& problem, const ParameterLayout& layout,
                      const reference::Jacobian& jacobian) {
    Eigen::MatrixXd matrix =
        Eigen::MatrixXd::Zero(2 * jacobian.num_observations(), layout.num_parameters(problem));
    for (int64_t i = 0; i < jacobian.num_observations(); ++i) {
        const int32_t image = jacobian.image[i], camera = problem.images[image].camera;
        for (int row = 0; row < 2; ++row) {
            const int64_t block_row = 2 * i + row;
            const double* of_image = jacobian.image_blocks.data() + block_row * jacobian.columns;
            for (int k = 0; k < num_pose_params; ++k)
                matrix(block_row, layout.pose_offset[image] + k) = of_image[k];
            for (int k = 0; k < problem.cameras[camera].num_params(); ++k)
                matrix(block_row, layout.intrinsics_offset[camera] + k) =
                    of_image[num_pose_params + k];
            for (int k = 0; k < 3; ++k)
                matrix(block_row, layout.num_f + 3 * int64_t{jacobian.point[i]} + k) =
                    jacobian.point_blocks[3 * block_row + k];
        }
    }
    return matrix;
}

}  // namespace clba::test
