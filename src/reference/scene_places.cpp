// SPDX-License-Identifier: Apache-2.0
#include "reference/scene_places.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace clba::scene {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double min_depth = 1;  // of a point that an image sees, metres

// heading: angle from x to y; pitch: angle above the horizon.
Vector3d direction(double heading, double pitch) {
    return {std::cos(pitch) * std::cos(heading), std::cos(pitch) * std::sin(heading),
            std::sin(pitch)};
}

View view_from(const Vector3d& center, const Vector3d& forward, double roll) {
    const Vector3d level = forward.cross(Vector3d::UnitZ()).normalized();
    const Vector3d upright = level.cross(forward);
    View view;
    view.rotation.row(0) = std::cos(roll) * level + std::sin(roll) * upright;
    view.rotation.row(1) = std::cos(roll) * upright - std::sin(roll) * level;
    view.rotation.row(2) = -forward;
    view.center = center;
    return view;
}

void set_intrinsics(View& view, double f, Random& random) {
    view.f = f;
    view.k1 = -0.05 + 0.01 * random.normal();
    view.k2 = 0.01 + 0.003 * random.normal();
}

// The usual half window along a path, or a wider one where tracks are long.
int32_t half_window(int32_t usual, double mean_length) {
    return static_cast<int32_t>(std::clamp(1.5 * mean_length, 1.0 * usual, 1e6));
}

int32_t draw_from_window(int32_t image, int32_t reach, int32_t num_images, bool is_closed,
                         Random& random) {
    if (is_closed && num_images > 2 * reach)
        return (image + num_images - reach + random.below(2 * reach + 1)) % num_images;
    const int32_t first = std::max(0, image - reach);
    const int32_t last = std::min(num_images - 1, image + reach);
    return first + random.below(last - first + 1);
}

// A rectangular hall, photographed outwards from a rounded rectangle at a constant distance from
// its walls. With many images the hall is larger, so that neighbours keep their distance; with few
// they cover a part of it.
class Hall final : public Place {
public:
    Hall(int32_t num_images, double mean_length)
        : num_images_(num_images), half_window_(half_window(12, mean_length)) {
        const double growth = std::max(0.0, least_spacing * num_images - perimeter()) / 8;
        half_length_ += growth;
        half_breadth_ += growth;
        spacing_ = std::min(perimeter() / num_images, most_spacing);
        is_closed_ = spacing_ < most_spacing;
    }

    View make_view(int32_t image, Random& random) const override {
        auto [position, heading] = on_path(image * spacing_);
        position.z() = random.uniform(1.4, 2.2);
        heading += 10 * radians_per_degree * random.normal();
        const double pitch = (4 + 6 * random.normal()) * radians_per_degree;
        const double roll = 2 * radians_per_degree * random.normal();
        View view = view_from(position, direction(heading, pitch), roll);
        set_intrinsics(view, 800 * (1 + 0.005 * random.normal()), random);
        return view;
    }

    // Where a ray leaves the hall, or somewhat before: furniture, columns, beams.
    bool draw_point(int32_t, const View& view, Random& random, SurfacePoint& point) const override {
        const Vector3d ray = view.ray_through_random_pixel(random);
        const Vector3d low(-half_length_, -half_breadth_, 0), high(half_length_, half_breadth_, 10);
        double exit = std::numeric_limits<double>::infinity();
        for (int k = 0; k < 3; ++k) {
            if (ray[k] == 0) continue;
            const double t = ((ray[k] > 0 ? high[k] : low[k]) - view.center[k]) / ray[k];
            if (t >= exit) continue;
            exit = t;
            point.normal = Vector3d::Unit(k) * (ray[k] > 0 ? -1 : 1);
        }
        const double nearer = random.uniform();
        point.position = view.center + exit * (1 - 0.3 * nearer * nearer) * ray;
        return true;
    }

    int32_t draw_neighbour(int32_t image, Random& random) const override {
        return draw_from_window(image, half_window_, num_images_, is_closed_, random);
    }
    bool is_path() const override { return true; }
    bool is_closed() const override { return is_closed_; }

private:
    static constexpr double least_spacing = 0.15, most_spacing = 0.5;  // between images, metres
    static constexpr double wall_distance = 7, corner_radius = 4;

    // Half the straight parts of the path.
    double straight_length() const { return half_length_ - wall_distance - corner_radius; }
    double straight_breadth() const { return half_breadth_ - wall_distance - corner_radius; }
    double perimeter() const {
        return 4 * (straight_length() + straight_breadth()) + 2 * pi * corner_radius;
    }

    // Position and outward heading after a way along the path, counterclockwise.
    std::pair<Vector3d, double> on_path(double way) const {
        const double a = straight_length(), b = straight_breadth();
        const Vector3d corners[] = {{a, -b, 0}, {a, b, 0}, {-a, b, 0}, {-a, -b, 0}, {a, -b, 0}};
        const double arc = corner_radius * pi / 2;
        for (int side = 0;; side = (side + 1) % 4) {
            const double heading = side * pi / 2;
            const double length = (corners[side + 1] - corners[side]).norm();
            if (way < length)
                return {corners[side] + way / length * (corners[side + 1] - corners[side]) +
                            corner_radius * direction(heading, 0),
                        heading};
            way -= length;
            if (way < arc) {
                const double turned = heading + way / corner_radius;
                return {corners[side + 1] + corner_radius * direction(turned, 0), turned};
            }
            way -= arc;
        }
    }

    int32_t num_images_;
    int32_t half_window_;
    double half_length_ = 20, half_breadth_ = 12.5;
    double spacing_ = 0;
    bool is_closed_ = false;
};

// A vehicle's forward-looking camera, one image a metre, on a winding street between facades.
class Street final : public Place {
public:
    Street(int32_t num_images, double mean_length, Random& random)
        : num_images_(num_images), half_window_(half_window(20, mean_length)) {
        const double phase = random.uniform(0, 2 * pi), slow_phase = random.uniform(0, 2 * pi);
        Vector3d position = Vector3d::Zero();
        for (int32_t metre = 0; metre < num_images + view_range + 2; ++metre) {
            const double heading = 0.4 * std::sin(2 * pi * metre / 260 + phase) +
                                   0.25 * std::sin(2 * pi * metre / 610 + slow_phase);
            positions_.push_back(position);
            headings_.push_back(heading);
            position += direction(heading, 0);
        }
    }

    View make_view(int32_t image, Random& random) const override {
        Vector3d position = positions_[image];
        position.x() += random.uniform(-0.05, 0.05);
        position.y() += random.uniform(-0.05, 0.05);
        position.z() = 1.8 + random.uniform(-0.05, 0.05);
        const double heading = headings_[image] + 3 * radians_per_degree * random.normal();
        const double pitch = (3 + 1.5 * random.normal()) * radians_per_degree;
        const double roll = radians_per_degree * random.normal();
        View view = view_from(position, direction(heading, pitch), roll);
        set_intrinsics(view, 800 * (1 + 0.005 * random.normal()), random);
        return view;
    }

    bool draw_point(int32_t image, const View&, Random& random,
                    SurfacePoint& point) const override {
        const double ahead = random.uniform(4, view_range);
        const auto metre = static_cast<int32_t>(ahead);
        const double part = ahead - metre;
        const int32_t base = image + metre;
        const Vector3d middle = (1 - part) * positions_[base] + part * positions_[base + 1];
        const double heading = (1 - part) * headings_[base] + part * headings_[base + 1];
        const Vector3d left = direction(heading + pi / 2, 0);
        if (random.uniform() < 0.2) {  // the road
            point.position = middle + random.uniform(-8, 8) * left;
            point.normal = Vector3d::UnitZ();
        } else {
            const double side = random.below(2) == 0 ? 1 : -1;
            point.position = middle + side * random.uniform(8, 10) * left;
            point.position.z() = random.uniform(0, 10);
            point.normal = -side * left;
        }
        return true;
    }

    int32_t draw_neighbour(int32_t image, Random& random) const override {
        return draw_from_window(image, half_window_, num_images_, false, random);
    }
    bool is_path() const override { return true; }

private:
    static constexpr int32_t view_range = 40;  // metres ahead

    int32_t num_images_;
    int32_t half_window_;
    std::vector<Vector3d> positions_;  // of the path, one a metre
    std::vector<double> headings_;
};

// A free-standing building, photographed from anywhere around it (if the images are few, from a
// sector before its long side) with cameras of all kinds.
class Landmark final : public Place {
public:
    explicit Landmark(int32_t num_images) : num_images_(num_images) {}

    View make_view(int32_t, Random& random) const override {
        const double half_sector = std::min(pi, num_images_ * 8 * radians_per_degree);
        const double azimuth = pi / 2 + random.uniform(-half_sector, half_sector);
        const double distance = random.uniform(28, 55);
        Vector3d position = distance * direction(azimuth, 0);
        position.z() = random.uniform(1.5, 8);
        Vector3d target;
        target.x() = random.uniform(-0.8, 0.8) * half_length;
        target.y() = random.uniform(-0.8, 0.8) * half_breadth;
        target.z() = random.uniform(0.2, 0.8) * height;
        const double roll = 3 * radians_per_degree * random.normal();
        View view = view_from(position, (target - position).normalized(), roll);
        set_intrinsics(view, random.uniform(700, 900), random);
        return view;
    }

    // Where a ray enters the building's box, or somewhat before: balconies, columns, statues.
    bool draw_point(int32_t, const View& view, Random& random, SurfacePoint& point) const override {
        const Vector3d ray = view.ray_through_random_pixel(random);
        const Vector3d low(-half_length, -half_breadth, 0), high(half_length, half_breadth, height);
        double entry = 0, exit = std::numeric_limits<double>::infinity();
        for (int k = 0; k < 3; ++k) {
            if (ray[k] == 0) continue;
            const double sign = ray[k] > 0 ? 1 : -1;
            const double enter = ((ray[k] > 0 ? low[k] : high[k]) - view.center[k]) / ray[k];
            const double leave = ((ray[k] > 0 ? high[k] : low[k]) - view.center[k]) / ray[k];
            exit = std::min(exit, leave);
            if (enter <= entry) continue;
            entry = enter;
            point.normal = -sign * Vector3d::Unit(k);
        }
        if (entry == 0 || entry >= exit) return false;
        const double nearer = random.uniform();
        point.position = view.center + entry * (1 - 0.05 * nearer * nearer) * ray;
        return true;
    }

    int32_t draw_neighbour(int32_t, Random& random) const override {
        return random.below(num_images_);
    }
    bool is_path() const override { return false; }

private:
    static constexpr double half_length = 15, half_breadth = 10, height = 18;
    int32_t num_images_;
};

}  // namespace

Vector2d View::project(const Vector3d& position) const {
    const Vector3d p = rotation * (position - center);
    const double u = -p.x() / p.z(), v = -p.y() / p.z();
    const double r2 = u * u + v * v;
    const double scale = f * (1 + k1 * r2 + k2 * r2 * r2);
    return {scale * u, scale * v};
}

bool View::sees(const SurfacePoint& point) const {
    constexpr double least_cosine = 0.1;  // flatter surfaces cannot be matched
    const Vector3d ray = center - point.position;
    if (point.normal.dot(ray) < least_cosine * ray.norm()) return false;
    if (depth(point.position) < min_depth) return false;
    const Vector2d pixel = project(point.position);
    return std::abs(pixel.x()) < half_width && std::abs(pixel.y()) < half_height;
}

Vector3d View::ray_through_random_pixel(Random& random) const {
    const double u = random.uniform(-half_width, half_width) / f;
    const double v = random.uniform(-half_height, half_height) / f;
    return rotation.transpose() * Vector3d(u, v, -1);
}

std::unique_ptr<Place> make_place(const SceneOptions& options, double mean_length, Random& random) {
    if (options.kind == SceneKind::hall)
        return std::make_unique<Hall>(options.num_images, mean_length);
    if (options.kind == SceneKind::street)
        return std::make_unique<Street>(options.num_images, mean_length, random);
    return std::make_unique<Landmark>(options.num_images);
}

}  // namespace clba::scene
