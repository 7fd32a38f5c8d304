// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <unsupported/Eigen/AutoDiff>

#include "base/error.hpp"
#include "problem/problem.hpp"

// Host twins of kernels/camera_models, by the formulas in clba.h. The kernels' derivatives are
// worked out by hand; here they come from automatic differentiation, so that one checks the other.
namespace clba::reference {

template <class T>
T radial_factor(const T& k1, const T& k2, const T& r2) {
    return 1.0 + r2 * (k1 + k2 * r2);
}

// 1 + k[0] x + k[1] x^2 + ...
template <class T, size_t Size>
T distortion_factor(const std::array<T, Size>& k, const T& x) {
    T factor = k[Size - 1];
    for (size_t i = Size - 1; i > 0; --i) factor = k[i - 1] + x * factor;
    return 1.0 + x * factor;
}

inline double arctangent(double x) {
    return std::atan(x);
}
template <class Derivatives>
Eigen::AutoDiffScalar<Derivatives> arctangent(const Eigen::AutoDiffScalar<Derivatives>& x) {
    return {std::atan(x.value()), x.derivatives() / (1 + x.value() * x.value())};
}

// atan(r) / r of r2 = r^2; the Taylor series where derivatives of the quotient lose digits.
template <class T>
T angle_ratio(const T& r2) {
    using std::sqrt;
    constexpr int num_terms = 15;  // of 1 / 16^15 = 9e-19 and less
    if (r2 < 1.0 / 16) {
        T sum = T(0.0);
        for (int k = num_terms - 1; k >= 0; --k) sum = 1.0 / (2 * k + 1) - r2 * sum;
        return sum;
    }
    const T r = sqrt(r2);
    return arctangent(r) / r;
}

// tan(h) / h; for small h by a continued fraction, as the quotient loses digits.
template <class T>
T tangent_ratio(const T& h) {
    using std::tan;
    if (h > 1.0 || h < -1.0) return tan(h) / h;
    const T h2 = h * h;
    T fraction = T(21.0);
    for (int k = 19; k >= 1; k -= 2) fraction = static_cast<double>(k) - h2 / fraction;
    return 1.0 / fraction;
}

// Each struct has
//   num_params  its number of parameters, in the order of clba.h
//   front_sign  the sign of z in front of the camera
//   project     the pixel of the point (x, y, z) of the camera's frame
struct snavely {
    static constexpr int num_params = 3;
    static constexpr int front_sign = -1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T u = -x / z, v = -y / z;
        const T r2 = u * u + v * v;
        const T factor = params[0] * radial_factor(params[1], params[2], r2);
        pixel_x = factor * u;
        pixel_y = factor * v;
    }
};

struct simple_pinhole {
    static constexpr int num_params = 3;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        pixel_x = params[0] * (x / z) + params[1];
        pixel_y = params[0] * (y / z) + params[2];
    }
};

struct pinhole {
    static constexpr int num_params = 4;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        pixel_x = params[0] * (x / z) + params[2];
        pixel_y = params[1] * (y / z) + params[3];
    }
};

struct simple_radial {
    static constexpr int num_params = 4;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T u = x / z, v = y / z;
        const T r2 = u * u + v * v;
        const T factor = params[0] * (1.0 + params[3] * r2);
        pixel_x = factor * u + params[1];
        pixel_y = factor * v + params[2];
    }
};

struct radial {
    static constexpr int num_params = 5;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T u = x / z, v = y / z;
        const T r2 = u * u + v * v;
        const T factor = params[0] * radial_factor(params[3], params[4], r2);
        pixel_x = factor * u + params[1];
        pixel_y = factor * v + params[2];
    }
};

struct opencv {
    static constexpr int num_params = 8;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T &p1 = params[6], &p2 = params[7];
        const T u = x / z, v = y / z;
        const T uu = u * u, uv = u * v, vv = v * v;
        const T r2 = uu + vv;
        const T factor = radial_factor(params[4], params[5], r2);
        const T du = 2.0 * p1 * uv + p2 * (r2 + 2.0 * uu);
        const T dv = 2.0 * p2 * uv + p1 * (r2 + 2.0 * vv);
        pixel_x = params[0] * (factor * u + du) + params[2];
        pixel_y = params[1] * (factor * v + dv) + params[3];
    }
};

struct opencv_fisheye {
    static constexpr int num_params = 8;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T u = x / z, v = y / z;
        const T r2 = u * u + v * v;
        const T ratio = angle_ratio(r2);
        const T angle2 = r2 * ratio * ratio;
        const std::array<T, 4> k = {params[4], params[5], params[6], params[7]};
        const T factor = ratio * distortion_factor(k, angle2);
        pixel_x = params[0] * factor * u + params[2];
        pixel_y = params[1] * factor * v + params[3];
    }
};

struct full_opencv {
    static constexpr int num_params = 12;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T &p1 = params[6], &p2 = params[7];
        const T u = x / z, v = y / z;
        const T uu = u * u, uv = u * v, vv = v * v;
        const T r2 = uu + vv;
        const std::array<T, 3> above = {params[4], params[5], params[8]};
        const std::array<T, 3> below = {params[9], params[10], params[11]};
        const T factor = distortion_factor(above, r2) / distortion_factor(below, r2);
        const T du = 2.0 * p1 * uv + p2 * (r2 + 2.0 * uu);
        const T dv = 2.0 * p2 * uv + p1 * (r2 + 2.0 * vv);
        pixel_x = params[0] * (factor * u + du) + params[2];
        pixel_y = params[1] * (factor * v + dv) + params[3];
    }
};

struct fov {
    static constexpr int num_params = 5;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T u = x / z, v = y / z;
        const T half = 0.5 * params[4];
        const T stretch = tangent_ratio(half);  // 2 tan(omega / 2) / omega
        const T c = params[4] * stretch;
        const T c2r2 = c * c * (u * u + v * v);
        const T factor = stretch * angle_ratio(c2r2);
        pixel_x = params[0] * factor * u + params[2];
        pixel_y = params[1] * factor * v + params[3];
    }
};

struct simple_radial_fisheye {
    static constexpr int num_params = 4;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T u = x / z, v = y / z;
        const T r2 = u * u + v * v;
        const T ratio = angle_ratio(r2);
        const T factor = params[0] * ratio * (1.0 + params[3] * r2 * ratio * ratio);
        pixel_x = factor * u + params[1];
        pixel_y = factor * v + params[2];
    }
};

struct radial_fisheye {
    static constexpr int num_params = 5;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T u = x / z, v = y / z;
        const T r2 = u * u + v * v;
        const T ratio = angle_ratio(r2);
        const T angle2 = r2 * ratio * ratio;
        const T factor = params[0] * ratio * radial_factor(params[3], params[4], angle2);
        pixel_x = factor * u + params[1];
        pixel_y = factor * v + params[2];
    }
};

struct thin_prism_fisheye {
    static constexpr int num_params = 12;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T &p1 = params[6], &p2 = params[7];
        const T u = x / z, v = y / z;
        const T r2 = u * u + v * v;
        const T ratio = angle_ratio(r2);
        const T a = ratio * u, b = ratio * v;
        const T aa = a * a, ab = a * b, bb = b * b;
        const T angle2 = aa + bb;
        const std::array<T, 4> k = {params[4], params[5], params[8], params[9]};
        const T factor = distortion_factor(k, angle2);
        const T da = 2.0 * p1 * ab + p2 * (angle2 + 2.0 * aa) + params[10] * angle2;
        const T db = 2.0 * p2 * ab + p1 * (angle2 + 2.0 * bb) + params[11] * angle2;
        pixel_x = params[0] * (factor * a + da) + params[2];
        pixel_y = params[1] * (factor * b + db) + params[3];
    }
};

struct brown {
    static constexpr int num_params = 8;
    static constexpr int front_sign = 1;

    template <class T>
    static void project(const T* params, const T& x, const T& y, const T& z, T& pixel_x,
                        T& pixel_y) {
        const T &p1 = params[6], &p2 = params[7];
        const T u = x / z, v = y / z;
        const T uu = u * u, uv = u * v, vv = v * v;
        const T r2 = uu + vv;
        const T factor = 1.0 + r2 * (params[3] + r2 * (params[4] + r2 * params[5]));
        const T du = 2.0 * p1 * uv + p2 * (r2 + 2.0 * uu);
        const T dv = 2.0 * p2 * uv + p1 * (r2 + 2.0 * vv);
        pixel_x = params[0] * (factor * u + du) + params[1];
        pixel_y = params[0] * (factor * v + dv) + params[2];
    }
};

#define CLBA_CAMERA_MODEL(name, number, size, param_names, num_kept) \
    static_assert(name::num_params == size && camera_models[number].num_params == size);
#include "problem/camera_models.def"
#undef CLBA_CAMERA_MODEL

// function(snavely{}), function(simple_pinhole{}), ... by the model's number.
template <class Function>
decltype(auto) with_camera_model(int32_t model, Function&& function) {
    switch (model) {
#define CLBA_CAMERA_MODEL(name, number, size, param_names, num_kept) \
    case number:                                                     \
        return function(name{});
#include "problem/camera_models.def"
#undef CLBA_CAMERA_MODEL
    }
    fail(Status::internal, "camera model ", model, " has no twin, but the models are 0 to ",
         num_camera_models - 1);
}

// The point lies in the camera's own plane, where P.x / P.z has no value worth following.
inline bool is_singular(double x, double y, double z) {
    return std::abs(z) <= 1e-10 * (std::abs(x) + std::abs(y));
}

struct Projection {
    Eigen::Vector2d pixel;  // the principal point if is_singular
    bool is_singular;
    bool is_behind;  // false if is_singular
};

// p in the camera's frame.
inline Projection project(const Camera& camera, const Eigen::Vector3d& p) {
    return with_camera_model(camera.model, [&](auto model) {
        using Model = decltype(model);
        Projection projection;
        projection.is_singular = is_singular(p.x(), p.y(), p.z());
        projection.is_behind = !projection.is_singular && Model::front_sign * p.z() < 0;
        const Eigen::Vector3d shown =
            projection.is_singular ? Eigen::Vector3d(Eigen::Vector3d::UnitZ()) : p;
        Model::project(camera.params.data(), shown.x(), shown.y(), shown.z(), projection.pixel.x(),
                       projection.pixel.y());
        return projection;
    });
}

struct ProjectionDerivatives {
    Eigen::Matrix<double, 2, 3> point;                   // d pixel / d p
    Eigen::Matrix<double, 2, max_camera_params> params;  // columns past the model's are 0
};

// All 0 where the observation is singular.
inline ProjectionDerivatives projection_derivatives(const Camera& camera,
                                                    const Eigen::Vector3d& p) {
    return with_camera_model(camera.model, [&](auto model) {
        using Model = decltype(model);
        constexpr int num_inputs = 3 + Model::num_params;
        using Scalar = Eigen::AutoDiffScalar<Eigen::Matrix<double, num_inputs, 1>>;
        ProjectionDerivatives derivatives;
        derivatives.point.setZero();
        derivatives.params.setZero();
        if (is_singular(p.x(), p.y(), p.z())) return derivatives;
        Scalar point[3], params[Model::num_params], pixel[2];
        for (int k = 0; k < 3; ++k) point[k] = Scalar(p[k], num_inputs, k);
        for (int k = 0; k < Model::num_params; ++k)
            params[k] = Scalar(camera.params[k], num_inputs, 3 + k);
        Model::project(params, point[0], point[1], point[2], pixel[0], pixel[1]);
        for (int row = 0; row < 2; ++row) {
            derivatives.point.row(row) = pixel[row].derivatives().template head<3>();
            derivatives.params.row(row).template head<Model::num_params>() =
                pixel[row].derivatives().template tail<Model::num_params>();
        }
        return derivatives;
    });
}

}  // namespace clba::reference
