// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <memory>

#include "reference/random.hpp"
#include "reference/scene.hpp"

namespace clba::scene {

constexpr double pi = 3.14159265358979323846;
constexpr double radians_per_degree = pi / 180;
constexpr double half_width = 500, half_height = 375;  // of an image, pixels

struct SurfacePoint {
    Eigen::Vector3d position;
    Eigen::Vector3d normal;
};

// A true image: metres, z up.
struct View {
    Eigen::Matrix3d rotation;  // camera from world
    Eigen::Vector3d center;
    double f, k1, k2;

    double depth(const Eigen::Vector3d& position) const {
        return -rotation.row(2).dot(position - center);
    }
    Eigen::Vector2d project(const Eigen::Vector3d& position) const;
    bool sees(const SurfacePoint& point) const;
    Eigen::Vector3d ray_through_random_pixel(Random& random) const;
};

// What is photographed, and from where.
class Place {
public:
    virtual ~Place() = default;
    virtual View make_view(int32_t image, Random& random) const = 0;
    // A point of the surface that the view perhaps sees; false: this try met none.
    virtual bool draw_point(int32_t image, const View& view, Random& random,
                            SurfacePoint& point) const = 0;
    // An image whose view overlaps that of `image`, perhaps the same.
    virtual int32_t draw_neighbour(int32_t image, Random& random) const = 0;
    virtual bool is_path() const = 0;  // images follow each other along a path
    virtual bool is_closed() const { return false; }
};

// Tracks of mean_length images on average are to be drawn from the neighbours.
std::unique_ptr<Place> make_place(const SceneOptions& options, double mean_length, Random& random);

}  // namespace clba::scene
