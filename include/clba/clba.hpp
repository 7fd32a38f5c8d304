// SPDX-License-Identifier: Apache-2.0
//
// clba.hpp -- clba.h for C++17: handles that release themselves, exceptions instead of status
// codes, containers instead of pointer, count and stride. Header-only; everything is inline and
// calls the C functions of the same name, whose comments in clba.h hold here too. Enumerations and
// structs are those of clba.h.
//
//   errors     Every failure throws clba::Error. An object that was moved from holds NULL, which
//   the
//              C functions refuse.
//   callbacks  What a callback throws stops the solve, passes no C frame, and comes out of
//              Problem::solve(); the problem then holds the best state found.
//   copies     Setters and the functions called get_... take views (Rows, CameraRows) of the
//              caller's memory, whatever its layout. Texts are views of the result's memory.
#ifndef CLBA_CLBA_HPP
#define CLBA_CLBA_HPP
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <exception>
#include <functional>
#include <iterator>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "clba/clba.h"

namespace clba {

using DeviceInfo = clba_device_info;
using ProblemInfo = clba_problem_info;
using Iteration = clba_iteration;
using Summary = clba_summary;
using Comparison = clba_comparison;
using CovarianceInfo = clba_covariance_info;

// ---- Errors -------------------------------------------------------------------------------------

class Error : public std::runtime_error {
public:
    Error(clba_status status, const std::string& message)
        : std::runtime_error(message), status_(status) {}
    clba_status status() const noexcept { return status_; }  // CLBA_ERROR_...

private:
    clba_status status_;
};

// Throws what the thread's last call said, unless it succeeded.
inline void check(clba_status status) {
    if (status == CLBA_OK) return;
    const char* message = clba_last_error();
    throw Error(status, *message ? message : clba_status_string(status));
}

namespace detail {

inline void require(bool holds, const std::string& message) {
    if (!holds) throw Error(CLBA_ERROR_INVALID_ARGUMENT, message);
}

// A name from one of the C functions that give NULL for an unknown value.
inline std::string_view name(const char* (*function)(int32_t), int32_t value, const char* what) {
    const char* text = function(value);
    require(text != nullptr, "there is no " + std::string(what) + " " + std::to_string(value));
    return text;
}

template <class Struct>
Struct sized() {
    Struct made{};
    made.struct_size = static_cast<uint32_t>(sizeof(Struct));
    return made;
}

// Of a container without gaps: a pointer to its elements.
template <class Container, class = decltype(std::size(std::declval<Container&>()))>
using Data = decltype(std::data(std::declval<Container&>()));

// From a pointer to rows, which are numbers or arrays of `width` numbers: a pointer to numbers.
template <size_t width, class Value>
Value* numbers(Value* data, size_t) {
    return data;
}
template <size_t width, class Value>
Value* numbers(std::array<Value, width>* rows, size_t count) {
    return count ? rows->data() : nullptr;
}
template <size_t width, class Value>
const Value* numbers(const std::array<Value, width>* rows, size_t count) {
    return count ? rows->data() : nullptr;
}
template <class Container, size_t width>
using Numbers = decltype(numbers<width>(std::declval<Data<Container>>(), 0));

inline int32_t count32(int64_t count, const char* what) {
    require(count <= INT32_MAX, std::to_string(count) + " " + what +
                                    ", but there may be no more than " + std::to_string(INT32_MAX));
    return static_cast<int32_t>(count);
}

inline void require_equal(int64_t count, int64_t expected, const char* what, const char* rule) {
    require(count == expected,
            std::to_string(count) + " " + what + ", but " + std::to_string(expected) + " " + rule);
}

}  // namespace detail

// Of the library loaded.
inline uint32_t version() noexcept {
    return clba_version();
}

// Throws unless the library loaded has the interface that this header was compiled with: the same
// major version and, before 1.0, the same minor version.
inline void check_version() {
    const uint32_t loaded = clba_version(), compiled = CLBA_VERSION;
    const uint32_t interface_of = compiled >= 10000 ? 10000 : 100;
    if (loaded / interface_of == compiled / interface_of) return;
    throw Error(CLBA_ERROR_INTERNAL,
                "the clba library loaded has version " + std::to_string(loaded) +
                    ", but the program was built for " + std::to_string(compiled) +
                    "; install the version it was built for, or build it again");
}

inline std::string_view status_string(clba_status status) noexcept {
    return clba_status_string(status);
}
inline std::string_view camera_model_name(int32_t model) {
    return detail::name(clba_camera_model_name, model, "camera model");
}
inline std::string_view camera_model_param_names(int32_t model) {
    return detail::name(clba_camera_model_param_names, model, "camera model");
}
inline int32_t camera_model_num_params(int32_t model) {
    const int32_t count = clba_camera_model_num_params(model);
    detail::require(count >= 0, "there is no camera model " + std::to_string(model));
    return count;
}
inline int32_t num_camera_models() noexcept {
    return clba_num_camera_models();
}
inline std::string_view loss_name(int32_t loss) {
    return detail::name(clba_loss_name, loss, "loss");
}
inline std::string_view linear_solver_name(int32_t linear_solver) {
    return detail::name(clba_linear_solver_name, linear_solver, "linear solver");
}
inline std::string_view preconditioner_name(int32_t preconditioner) {
    return detail::name(clba_preconditioner_name, preconditioner, "preconditioner");
}
inline std::string_view damping_name(int32_t damping) {
    return detail::name(clba_damping_name, damping, "damping");
}
inline std::string_view precision_name(int32_t precision) {
    return detail::name(clba_precision_name, precision, "precision");
}
inline std::string_view jacobian_name(int32_t jacobian) {
    return detail::name(clba_jacobian_name, jacobian, "jacobian");
}
inline std::string_view format_name(int32_t format) {
    return detail::name(clba_format_name, format, "format");
}
inline std::string_view covariance_gauge_name(int32_t gauge) {
    return detail::name(clba_covariance_gauge_name, gauge, "gauge");
}
inline std::string_view covariance_method_name(int32_t method) {
    return detail::name(clba_covariance_method_name, method, "covariance method");
}
inline std::string_view unit_name(int32_t unit) {
    return detail::name(clba_unit_name, unit, "unit");
}
inline std::string_view gauge_state_name(int32_t gauge) {
    return detail::name(clba_gauge_state_name, gauge, "gauge state");
}
inline std::string_view scene_name(int32_t scene) {
    return detail::name(clba_scene_name, scene, "scene");
}

// ---- Arrays -------------------------------------------------------------------------------------

// Rows of `width` values in memory that belongs to somebody else: `const double` for input,
// `double` for output. Made from
//   - a container of values without gaps, whose size is a multiple of the width,
//   - a container of std::array<value, width>,
//   - a pointer, a count of rows and a stride in bytes (0: no gaps), for columns of larger structs.
template <class Value, size_t width>
class Rows {
public:
    Rows() = default;  // none
    Rows(Value* data, int64_t count, size_t stride = 0)
        : data_(data), count_(count), stride_(stride) {}

    template <
        class Container,
        std::enable_if_t<std::is_convertible_v<detail::Numbers<Container, width>, Value*>, int> = 0>
    Rows(Container&& rows) : data_(detail::numbers<width>(std::data(rows), std::size(rows))) {
        const size_t size = std::size(rows);
        constexpr bool has_numbers =
            std::is_same_v<detail::Numbers<Container, width>, detail::Data<Container>>;
        detail::require(!has_numbers || size % width == 0,
                        std::to_string(size) + " numbers, but a row has " + std::to_string(width));
        count_ = static_cast<int64_t>(has_numbers ? size / width : size);
    }

    Value* data() const noexcept { return data_; }
    int64_t count() const noexcept { return count_; }
    size_t stride() const noexcept { return stride_; }

private:
    Value* data_ = nullptr;
    int64_t count_ = 0;
    size_t stride_ = 0;
};

// One row a camera, as long as its model has parameters: a container of all rows without gaps,
// whose size is checked, or a pointer and a stride in bytes.
template <class Value>
class CameraRows {
public:
    CameraRows() = default;  // none
    CameraRows(Value* data, size_t stride) : data_(data), stride_(stride), size_(unknown) {}
    template <class Container,
              std::enable_if_t<std::is_convertible_v<detail::Data<Container>, Value*>, int> = 0>
    CameraRows(Container&& values)
        : data_(std::data(values)), size_(static_cast<int64_t>(std::size(values))) {}

    Value* data() const noexcept { return data_; }
    size_t stride() const noexcept { return stride_; }

    // size: the number of parameters of all the cameras together.
    void require_size(int64_t size) const {
        if (size_ != unknown)
            detail::require_equal(size_, size, "numbers for the cameras", "are needed");
    }
    bool empty() const noexcept { return size_ == 0; }

private:
    static constexpr int64_t unknown = -1;
    Value* data_ = nullptr;
    size_t stride_ = 0;
    int64_t size_ = 0;
};

struct Cameras {
    std::vector<int32_t> models;
    std::vector<double> params;  // a row a camera, without gaps
};
struct Images {
    std::vector<int32_t> cameras;
    std::vector<std::array<double, 7>> poses;  // qw qx qy qz tx ty tz
};
// What files hold beside the problem, a row each (clba_problem_get_camera_info, ...).
struct CameraInfo {
    std::vector<uint64_t> ids;
    std::vector<std::array<uint64_t, 2>> sizes;  // width, height
};
struct ImageInfo {
    std::vector<uint64_t> ids;
    std::vector<std::string> names;
};
struct PointInfo {
    std::vector<uint64_t> ids;
    std::vector<std::array<uint8_t, 3>> colors;
};
// clba_rigs: frames and sensors of each image, -1 where it is in no rig. Frames without poses get
// them from their images, and what is constant nowhere is empty.
struct Rigs {
    std::vector<int32_t> frames, sensors;
    std::vector<std::array<double, 7>> sensor_poses, frame_poses;
    std::vector<int32_t> constant_sensors, constant_frames;  // sums of CLBA_CONSTANT_*
};

struct Observations {
    std::vector<int32_t> images, points;
    std::vector<std::array<double, 2>> xy;
};

// ---- Options: the C structs, filled with defaults -----------------------------------------------

struct ContextOptions : clba_context_options {
    ContextOptions() : clba_context_options() {
        check(clba_context_options_init(this, sizeof(clba_context_options)));
    }
};
struct SolverOptions : clba_solver_options {
    SolverOptions() : clba_solver_options() {
        check(clba_solver_options_init(this, sizeof(clba_solver_options)));
    }
};
struct ReadOptions : clba_read_options {
    ReadOptions() : clba_read_options() {
        check(clba_read_options_init(this, sizeof(clba_read_options)));
    }
};
struct WriteOptions : clba_write_options {
    WriteOptions() : clba_write_options() {
        check(clba_write_options_init(this, sizeof(clba_write_options)));
    }
};
struct SceneOptions : clba_scene_options {
    SceneOptions() : clba_scene_options() {
        check(clba_scene_options_init(this, sizeof(clba_scene_options)));
    }
};
struct FilterOptions : clba_filter_options {
    FilterOptions() : clba_filter_options() {
        check(clba_filter_options_init(this, sizeof(clba_filter_options)));
    }
};
// What evaluate() is to compute, and where to: pointers left NULL are skipped.
struct EvaluationRequest : clba_evaluation {
    EvaluationRequest() : clba_evaluation() {
        check(clba_evaluation_init(this, sizeof(clba_evaluation)));
    }
};

struct CovarianceOptions : clba_covariance_options {
    CovarianceOptions() : clba_covariance_options() {
        check(clba_covariance_options_init(this, sizeof(clba_covariance_options)));
    }
};
struct GaugeTarget : clba_gauge_target {
    GaugeTarget() : clba_gauge_target() {
        check(clba_gauge_target_init(this, sizeof(clba_gauge_target)));
    }
};

// Images, and points if they are not all that these see, to refine while the rest stays.
struct Window : clba_window {
    Window(std::vector<int32_t> of_images) : Window(std::move(of_images), {}, false) {}
    Window(std::vector<int32_t> of_images, std::vector<int32_t> of_points)
        : Window(std::move(of_images), std::move(of_points), true) {}

    // Points the C struct to the lists.
    clba_window& fill() {
        num_images = detail::count32(static_cast<int64_t>(image_rows.size()), "images");
        num_points = detail::count32(static_cast<int64_t>(point_rows.size()), "points");
        images = image_rows.data();
        static constexpr int32_t none = 0;
        points = !names_points ? nullptr : point_rows.empty() ? &none : point_rows.data();
        return *this;
    }

    std::vector<int32_t> image_rows, point_rows;
    bool names_points;

private:
    Window(std::vector<int32_t> of_images, std::vector<int32_t> of_points, bool names)
        : clba_window(),
          image_rows(std::move(of_images)),
          point_rows(std::move(of_points)),
          names_points(names) {
        check(clba_window_init(this, sizeof(clba_window)));
    }
};

// ---- Handles ------------------------------------------------------------------------------------

namespace detail {

inline void release(clba_context* handle) noexcept {
    clba_context_release(handle);
}
inline void release(clba_problem* handle) noexcept {
    clba_problem_release(handle);
}
inline void release(clba_result* handle) noexcept {
    clba_result_release(handle);
}
inline void release(clba_covariance* handle) noexcept {
    clba_covariance_release(handle);
}

inline void release(clba_cancellation* handle) noexcept {
    clba_cancellation_release(handle);
}

// Owns one reference.
template <class Object>
class Handle {
public:
    Handle() noexcept = default;
    explicit Handle(Object* owned) noexcept : object_(owned) {}
    Handle(Handle&& other) noexcept : object_(std::exchange(other.object_, nullptr)) {}
    Handle& operator=(Handle&& other) noexcept {
        if (this != &other) {
            release(object_);
            object_ = std::exchange(other.object_, nullptr);
        }
        return *this;
    }
    ~Handle() { release(object_); }

    Object* get() const noexcept { return object_; }                       // still owned by this
    Object* detach() noexcept { return std::exchange(object_, nullptr); }  // now the caller's
    explicit operator bool() const noexcept { return object_ != nullptr; }

protected:
    Object* object_ = nullptr;
};

}  // namespace detail

// All OpenCL devices; where there are none, clba_last_error() says what is missing.
inline std::vector<DeviceInfo> devices() {
    int32_t count = 0;
    check(clba_num_devices(&count));
    std::vector<DeviceInfo> infos(static_cast<size_t>(count), detail::sized<DeviceInfo>());
    for (int32_t i = 0; i < count; ++i) check(clba_get_device(i, &infos[static_cast<size_t>(i)]));
    return infos;
}

// One device and the kernels built for it; may be shared between threads.
class Context : public detail::Handle<clba_context> {
public:
    using Handle::Handle;  // takes over a handle

    Context() : Context(ContextOptions()) {}  // the best device
    // An index, or a part of the platform's or device's name.
    explicit Context(const std::string& device) : Context(for_device(device.c_str())) {}
    explicit Context(const ContextOptions& options) {
        check(clba_context_create(&options, &object_));
    }

    Context share() const {  // a second owner of the same context
        check(clba_context_retain(object_));
        return Context(object_);
    }
    DeviceInfo device() const {
        auto info = detail::sized<DeviceInfo>();
        check(clba_context_get_device(object_, &info));
        return info;
    }

private:
    static ContextOptions for_device(const char* device) {
        ContextOptions options;
        options.device = device;
        return options;
    }
};

// What a solve did. An empty one has no rows and empty texts.
class Result : public detail::Handle<clba_result> {
public:
    using Handle::Handle;

    Summary summary() const {
        auto summary = detail::sized<Summary>();
        check(clba_result_get_summary(object_, &summary));
        return summary;
    }
    int32_t num_rows() const noexcept { return clba_result_num_rows(object_); }
    Iteration row(int32_t index) const {
        auto row = detail::sized<Iteration>();
        check(clba_result_get_row(object_, index, &row));
        return row;
    }
    std::vector<Iteration> rows() const {
        std::vector<Iteration> all;
        all.reserve(static_cast<size_t>(num_rows()));
        for (int32_t i = 0; i < num_rows(); ++i) all.push_back(row(i));
        return all;
    }
    std::string_view report() const { return clba_result_report(object_); }
    std::string_view json() const { return clba_result_json(object_); }
};

// Ends the solves whose options name it: `options.cancellation = cancellation.get()`. request(),
// reset() and is_requested() may be called from any thread.
class Cancellation : public detail::Handle<clba_cancellation> {
public:
    using Handle::Handle;

    Cancellation() { check(clba_cancellation_create(&object_)); }
    Cancellation share() const {
        check(clba_cancellation_retain(object_));
        return Cancellation(object_);
    }
    void request() noexcept { clba_cancellation_request(object_); }
    void reset() noexcept { clba_cancellation_reset(object_); }
    bool is_requested() const noexcept { return clba_cancellation_is_requested(object_) != 0; }
};

enum class Next { go_on, stop };
using IterationCallback = std::function<Next(const Iteration&)>;
using ProgressCallback = std::function<Next(double)>;

struct Offsets {
    std::vector<int64_t> poses, intrinsics;  // one an image; one a camera
};

struct Evaluation {
    double cost = 0;
    int64_t num_behind = 0, num_singular = 0;
    std::vector<double> residuals, gradient, jacobian_images, jacobian_points;
};

// Covariances of a state's parameters: symmetric matrices by rows.
class Covariance : public detail::Handle<clba_covariance> {
public:
    using Handle::Handle;

    CovarianceInfo info() const {
        auto info = detail::sized<CovarianceInfo>();
        check(clba_covariance_get_info(object_, &info));
        return info;
    }
    std::array<double, 36> pose(int64_t image) const { return fixed<36>(CLBA_BLOCK_POSE, image); }
    std::array<double, 9> center(int64_t image) const { return fixed<9>(CLBA_BLOCK_CENTER, image); }
    // Of the index-th point asked for.
    std::array<double, 9> point(int64_t index) const { return fixed<9>(CLBA_BLOCK_POINT, index); }
    // Any block: size x size numbers, which must be what clba.h says for it.
    std::vector<double> block(int32_t block, int64_t row, size_t size) const {
        std::vector<double> values(size * size);
        check(clba_covariance_get(object_, block, row, 1, values.data(), nullptr,
                                  values.size() * sizeof(double)));
        return values;
    }
    // Like block(): standard errors of its entries as estimates.
    std::vector<double> standard_errors(int32_t block, int64_t row, size_t size) const {
        std::vector<double> values(size * size), errors(size * size);
        check(clba_covariance_get(object_, block, row, 1, values.data(), errors.data(),
                                  values.size() * sizeof(double)));
        return errors;
    }

private:
    template <size_t size>
    std::array<double, size> fixed(int32_t block, int64_t row) const {
        std::array<double, size> values;
        check(clba_covariance_get(object_, block, row, 1, values.data(), nullptr, 0));
        return values;
    }
};

// What was removed; counts are those of clba_filter_report.
struct Removed {
    clba_filter_report counts;               // without its arrays
    std::vector<int64_t> observation_rows;   // of each row before: its row now, -1 if removed
    std::vector<int32_t> point_rows;         // likewise
    std::vector<int32_t> unobserved_images;  // 1: the image lost all its observations
};

// Images, cameras, points and observations; used by one thread at a time.
class Problem : public detail::Handle<clba_problem> {
public:
    using Handle::Handle;

    Problem() { check(clba_problem_create(&object_)); }  // an empty one

    // Of any format. on_progress gets the fraction read; what it throws comes out of here.
    static Problem read(const std::string& path, const ReadOptions& options = {},
                        const ProgressCallback& on_progress = {}) {
        clba_read_options given = options;
        Call<ProgressCallback> call{on_progress, nullptr};
        if (on_progress) {
            given.on_progress = &Call<ProgressCallback>::enter;
            given.user_data = &call;
        }
        clba_problem* made = nullptr;
        const clba_status status = clba_problem_read(path.c_str(), &given, &made);
        if (call.thrown) std::rethrow_exception(call.thrown);
        check(status);
        return Problem(made);
    }
    void write(const std::string& path, const WriteOptions& options = {}) const {
        check(clba_problem_write(object_, path.c_str(), &options));
    }
    void check_write(const std::string& path, const WriteOptions& options = {}) const {
        check(clba_problem_check_write(object_, path.c_str(), &options));
    }
    std::string_view notices() const { return clba_problem_notices(object_); }
    int32_t format() const { return clba_problem_get_format(object_); }

    CameraInfo camera_info() const {
        const auto count = static_cast<size_t>(info().num_cameras);
        CameraInfo rows{std::vector<uint64_t>(count), std::vector<std::array<uint64_t, 2>>(count)};
        check(clba_problem_get_camera_info(object_, 0, static_cast<int32_t>(count), rows.ids.data(),
                                           0, detail::numbers<2>(rows.sizes.data(), count), 0));
        return rows;
    }
    ImageInfo image_info() const {
        const auto count = static_cast<size_t>(info().num_images);
        ImageInfo rows{std::vector<uint64_t>(count), {}};
        check(clba_problem_get_image_ids(object_, 0, static_cast<int32_t>(count), rows.ids.data(),
                                         0));
        for (size_t i = 0; i < count; ++i)
            rows.names.emplace_back(clba_problem_get_image_name(object_, static_cast<int32_t>(i)));
        return rows;
    }
    PointInfo point_info() const {
        const auto count = static_cast<size_t>(info().num_points);
        PointInfo rows{std::vector<uint64_t>(count), std::vector<std::array<uint8_t, 3>>(count)};
        check(clba_problem_get_point_info(object_, 0, static_cast<int32_t>(count), rows.ids.data(),
                                          0, detail::numbers<3>(rows.colors.data(), count), 0));
        return rows;
    }

    static Problem read_bal(const std::string& path) {
        clba_problem* made = nullptr;
        check(clba_problem_read_bal(path.c_str(), &made));
        return Problem(made);
    }
    void write_bal(const std::string& path) const {
        check(clba_problem_write_bal(object_, path.c_str()));
    }
    void write_ply(const std::string& path) const {
        check(clba_problem_write_ply(object_, path.c_str()));
    }

    Problem share() const {  // a second owner of the same problem
        check(clba_problem_retain(object_));
        return Problem(object_);
    }

    ProblemInfo info() const {
        auto info = detail::sized<ProblemInfo>();
        check(clba_problem_get_info(object_, &info));
        return info;
    }

    // -- Setters replace all rows; where the C function takes a count of 0, so do these: {}

    void set_cameras(Rows<const int32_t, 1> models, CameraRows<const double> params) {
        int64_t size = 0;
        for (int64_t i = 0; i < models.count(); ++i)
            size += camera_model_num_params(value(models, i));
        params.require_size(size);
        check(clba_problem_set_cameras(object_, detail::count32(models.count(), "cameras"),
                                       models.data(), models.stride(), params.data(),
                                       params.stride()));
    }
    void set_images(Rows<const int32_t, 1> cameras, Rows<const double, 7> poses) {
        detail::require_equal(poses.count(), cameras.count(), "poses", "camera indices");
        check(clba_problem_set_images(object_, detail::count32(poses.count(), "images"),
                                      cameras.data(), cameras.stride(), poses.data(),
                                      poses.stride()));
    }
    void set_points(Rows<const double, 3> xyz) {
        check(clba_problem_set_points(object_, detail::count32(xyz.count(), "points"), xyz.data(),
                                      xyz.stride()));
    }
    void set_observations(Rows<const int32_t, 1> images, Rows<const int32_t, 1> points,
                          Rows<const double, 2> xy) {
        detail::require_equal(images.count(), xy.count(), "image indices", "observations");
        detail::require_equal(points.count(), xy.count(), "point indices", "observations");
        check(clba_problem_set_observations(object_, xy.count(), images.data(), images.stride(),
                                            points.data(), points.stride(), xy.data(),
                                            xy.stride()));
    }
    void set_covariances(Rows<const double, 3> covariances) {
        check(clba_problem_set_covariances(object_, covariances.count(), covariances.data(),
                                           covariances.stride()));
    }
    void set_sigmas(Rows<const double, 1> sigmas) {
        check(clba_problem_set_sigmas(object_, sigmas.count(), sigmas.data(), sigmas.stride()));
    }
    void set_constant_images(Rows<const int32_t, 1> flags) {
        check(clba_problem_set_constant_images(object_, detail::count32(flags.count(), "images"),
                                               flags.data(), flags.stride()));
    }
    void set_constant_cameras(Rows<const int32_t, 1> flags) {
        check(clba_problem_set_constant_cameras(object_, detail::count32(flags.count(), "cameras"),
                                                flags.data(), flags.stride()));
    }
    void set_constant_points(Rows<const int32_t, 1> flags) {
        check(clba_problem_set_constant_points(object_, detail::count32(flags.count(), "points"),
                                               flags.data(), flags.stride()));
    }
    void set_image_uncertainties(Rows<const double, 6> values) {
        check(clba_problem_set_image_uncertainties(
            object_, detail::count32(values.count(), "images"), values.data(), values.stride()));
    }
    void set_camera_uncertainties(CameraRows<const double> values) {
        int32_t count = 0;
        if (!values.empty()) {
            const std::vector<int32_t> models = camera_models();
            values.require_size(num_params(models));
            count = static_cast<int32_t>(models.size());
        }
        check(
            clba_problem_set_camera_uncertainties(object_, count, values.data(), values.stride()));
    }
    void set_point_uncertainties(Rows<const double, 3> values) {
        check(clba_problem_set_point_uncertainties(
            object_, detail::count32(values.count(), "points"), values.data(), values.stride()));
    }
    // -- Priors: all of a kind; {} removes them

    void set_position_priors(Rows<const int32_t, 1> images, Rows<const double, 3> positions,
                             Rows<const double, 9> covariances) {
        set_priors(clba_problem_set_position_priors, images, positions, covariances);
    }
    void set_pose_priors(Rows<const int32_t, 1> images, Rows<const double, 7> poses,
                         Rows<const double, 36> covariances) {
        set_priors(clba_problem_set_pose_priors, images, poses, covariances);
    }
    // covariances: n x n numbers a camera of n parameters.
    void set_intrinsics_priors(Rows<const int32_t, 1> cameras, CameraRows<const double> params,
                               CameraRows<const double> covariances) {
        const std::vector<int32_t> models = camera_models();
        int64_t size = 0, squared_size = 0;
        bool is_known = true;  // else the C function says which is not
        for (int64_t i = 0; i < cameras.count(); ++i) {
            const int32_t camera = value(cameras, i);
            is_known = is_known && camera >= 0 && camera < static_cast<int32_t>(models.size());
            if (!is_known) break;
            const int64_t n = camera_model_num_params(models[static_cast<size_t>(camera)]);
            size += n;
            squared_size += n * n;
        }
        if (is_known) params.require_size(size);
        if (is_known) covariances.require_size(squared_size);
        check(clba_problem_set_intrinsics_priors(
            object_, detail::count32(cameras.count(), "priors"), cameras.data(), cameras.stride(),
            params.data(), params.stride(), covariances.data(), covariances.stride()));
    }
    void set_point_priors(Rows<const int32_t, 1> points, Rows<const double, 3> positions,
                          Rows<const double, 9> covariances) {
        set_priors(clba_problem_set_point_priors, points, positions, covariances);
    }
    void set_relative_pose_priors(Rows<const int32_t, 2> pairs, Rows<const double, 7> poses,
                                  Rows<const double, 36> covariances) {
        set_priors(clba_problem_set_relative_pose_priors, pairs, poses, covariances);
    }

    void set_rigs(const Rigs& rigs) {  // {} removes them
        const int64_t num_images = info().num_images;
        const auto size = [](const auto& rows) { return static_cast<int64_t>(rows.size()); };
        auto described = detail::sized<clba_rigs>();
        check(clba_rigs_init(&described, sizeof described));
        for (const int32_t frame : rigs.frames)
            if (frame >= described.num_frames) described.num_frames = frame + 1;
        described.num_sensors = detail::count32(size(rigs.sensor_poses), "sensors");
        if (described.num_frames > 0) {
            detail::require_equal(size(rigs.frames), num_images, "frames", "images");
            detail::require_equal(size(rigs.sensors), num_images, "sensors", "images");
            for (const auto* rows : {&rigs.constant_sensors, &rigs.constant_frames})
                if (!rows->empty())
                    detail::require_equal(size(*rows),
                                          rows == &rigs.constant_frames ? described.num_frames
                                                                        : described.num_sensors,
                                          "constants",
                                          rows == &rigs.constant_frames ? "frames" : "sensors");
            if (!rigs.frame_poses.empty())
                detail::require_equal(size(rigs.frame_poses), described.num_frames, "frame_poses",
                                      "frames");
        }
        const auto ints = [](const auto& rows) { return rows.empty() ? nullptr : rows.data(); };
        const auto poses = [](const auto& rows) {
            return rows.empty() ? nullptr : rows.front().data();
        };
        described.frames = ints(rigs.frames);
        described.sensors = ints(rigs.sensors);
        described.sensor_poses = poses(rigs.sensor_poses);
        described.frame_poses = poses(rigs.frame_poses);
        described.constant_sensors = ints(rigs.constant_sensors);
        described.constant_frames = ints(rigs.constant_frames);
        check(clba_problem_set_rigs(object_, &described));
    }
    Rigs rigs() const {
        const ProblemInfo sizes = info();
        const auto num_images = static_cast<size_t>(sizes.num_images);
        const auto num_frames = static_cast<size_t>(sizes.num_frames);
        const auto num_sensors = static_cast<size_t>(sizes.num_sensors);
        Rigs rigs;
        if (num_frames == 0) return rigs;
        rigs.frames.resize(num_images);
        rigs.sensors.resize(num_images);
        rigs.frame_poses.resize(num_frames);
        rigs.constant_frames.resize(num_frames);
        rigs.sensor_poses.resize(num_sensors);
        rigs.constant_sensors.resize(num_sensors);
        check(clba_problem_get_image_rigs(object_, 0, sizes.num_images, rigs.frames.data(), 0,
                                          rigs.sensors.data(), 0));
        check(clba_problem_get_frames(object_, 0, sizes.num_frames, rigs.frame_poses.front().data(),
                                      0, rigs.constant_frames.data(), 0));
        check(clba_problem_get_sensors(object_, 0, sizes.num_sensors,
                                       rigs.sensor_poses.front().data(), 0,
                                       rigs.constant_sensors.data(), 0));
        return rigs;
    }

    void set_loss(int32_t loss, double scale = 1) {
        check(clba_problem_set_loss(object_, loss, scale));
    }

    // -- Appending: the rows before keep their index

    void add_cameras(Rows<const int32_t, 1> models, CameraRows<const double> params) {
        int64_t size = 0;
        for (int64_t i = 0; i < models.count(); ++i)
            size += camera_model_num_params(value(models, i));
        params.require_size(size);
        check(clba_problem_add_cameras(object_, detail::count32(models.count(), "cameras"),
                                       models.data(), models.stride(), params.data(),
                                       params.stride()));
    }
    void add_images(Rows<const int32_t, 1> cameras, Rows<const double, 7> poses) {
        detail::require_equal(poses.count(), cameras.count(), "poses", "camera indices");
        check(clba_problem_add_images(object_, detail::count32(poses.count(), "images"),
                                      cameras.data(), cameras.stride(), poses.data(),
                                      poses.stride()));
    }
    void add_points(Rows<const double, 3> xyz) {
        check(clba_problem_add_points(object_, detail::count32(xyz.count(), "points"), xyz.data(),
                                      xyz.stride()));
    }
    // Without covariances: the identity.
    void add_observations(Rows<const int32_t, 1> images, Rows<const int32_t, 1> points,
                          Rows<const double, 2> xy, Rows<const double, 3> covariances = {}) {
        detail::require_equal(images.count(), xy.count(), "image indices", "observations");
        detail::require_equal(points.count(), xy.count(), "point indices", "observations");
        if (covariances.data())
            detail::require_equal(covariances.count(), xy.count(), "covariances", "observations");
        check(clba_problem_add_observations(object_, xy.count(), images.data(), images.stride(),
                                            points.data(), points.stride(), xy.data(), xy.stride(),
                                            covariances.data(), covariances.stride()));
    }

    // -- Getters: everything, or rows from `first` on into the caller's memory

    Cameras cameras() const {
        Cameras cameras{camera_models(), {}};
        cameras.params.resize(static_cast<size_t>(num_params(cameras.models)));
        check(clba_problem_get_cameras(object_, 0, static_cast<int32_t>(cameras.models.size()),
                                       nullptr, 0, cameras.params.data(), 0));
        return cameras;
    }
    Images images() const {
        const auto count = static_cast<size_t>(info().num_images);
        Images images{std::vector<int32_t>(count), std::vector<std::array<double, 7>>(count)};
        get_images(0, images.cameras, images.poses);
        return images;
    }
    std::vector<std::array<double, 3>> centers() const {
        std::vector<std::array<double, 3>> centers(static_cast<size_t>(info().num_images));
        get_centers(0, centers);
        return centers;
    }
    std::vector<std::array<double, 3>> points() const {
        std::vector<std::array<double, 3>> xyz(static_cast<size_t>(info().num_points));
        get_points(0, xyz);
        return xyz;
    }
    // Flags as they are set.
    std::vector<int32_t> constant_images() const {
        std::vector<int32_t> flags(static_cast<size_t>(info().num_images));
        check(clba_problem_get_constant_images(object_, 0, static_cast<int32_t>(flags.size()),
                                               flags.data(), 0));
        return flags;
    }
    std::vector<int32_t> constant_cameras() const {
        std::vector<int32_t> flags(static_cast<size_t>(info().num_cameras));
        check(clba_problem_get_constant_cameras(object_, 0, static_cast<int32_t>(flags.size()),
                                                flags.data(), 0));
        return flags;
    }
    std::vector<int32_t> constant_points() const {
        std::vector<int32_t> flags(static_cast<size_t>(info().num_points));
        check(clba_problem_get_constant_points(object_, 0, static_cast<int32_t>(flags.size()),
                                               flags.data(), 0));
        return flags;
    }
    Observations observations() const {
        const auto count = static_cast<size_t>(info().num_observations);
        Observations observations{std::vector<int32_t>(count), std::vector<int32_t>(count),
                                  std::vector<std::array<double, 2>>(count)};
        get_observations(0, observations.images, observations.points, observations.xy);
        return observations;
    }

    void get_cameras(int32_t first, Rows<int32_t, 1> models, CameraRows<double> params) const {
        std::vector<int32_t> known(static_cast<size_t>(models.count()));
        const int32_t count = detail::count32(models.count(), "cameras");
        check(clba_problem_get_cameras(object_, first, count, known.data(), 0, nullptr, 0));
        params.require_size(num_params(known));
        check(clba_problem_get_cameras(object_, first, count, models.data(), models.stride(),
                                       params.data(), params.stride()));
    }
    void get_images(int32_t first, Rows<int32_t, 1> cameras, Rows<double, 7> poses) const {
        detail::require_equal(poses.count(), cameras.count(), "poses", "camera indices");
        check(clba_problem_get_images(object_, first, detail::count32(poses.count(), "images"),
                                      cameras.data(), cameras.stride(), poses.data(),
                                      poses.stride()));
    }
    void get_centers(int32_t first, Rows<double, 3> centers) const {
        check(clba_problem_get_centers(object_, first, detail::count32(centers.count(), "images"),
                                       centers.data(), centers.stride()));
    }
    void get_points(int32_t first, Rows<double, 3> xyz) const {
        check(clba_problem_get_points(object_, first, detail::count32(xyz.count(), "points"),
                                      xyz.data(), xyz.stride()));
    }
    void get_observations(int64_t first, Rows<int32_t, 1> images, Rows<int32_t, 1> points,
                          Rows<double, 2> xy) const {
        detail::require_equal(images.count(), xy.count(), "image indices", "observations");
        detail::require_equal(points.count(), xy.count(), "point indices", "observations");
        check(clba_problem_get_observations(object_, first, xy.count(), images.data(),
                                            images.stride(), points.data(), points.stride(),
                                            xy.data(), xy.stride()));
    }

    // -- Removing outliers

    std::vector<double> reprojection_errors(int32_t unit = CLBA_UNIT_PIXELS) const {
        std::vector<double> errors(static_cast<size_t>(info().num_observations));
        check(clba_problem_get_reprojection_errors(
            object_, unit, 0, static_cast<int64_t>(errors.size()), errors.data(), 0));
        return errors;
    }
    Removed filter(const FilterOptions& options = {}) {
        return remove([&](clba_filter_report& report) {
            return clba_problem_filter(object_, &options, &report);
        });
    }
    Removed remove_observations(Rows<const int32_t, 1> flags, bool remove_points = false) {
        return remove([&](clba_filter_report& report) {
            return clba_problem_remove_observations(object_, flags.count(), flags.data(),
                                                    flags.stride(), remove_points, &report);
        });
    }

    // -- Solving

    // on_iteration, if there is one, takes the place of the options' C callback.
    Result solve(const Context& context, const SolverOptions& options = {},
                 const IterationCallback& on_iteration = {}) {
        return solve_by(
            [&](const clba_solver_options& given, clba_result** made) {
                return clba_problem_solve(object_, context.get(), &given, made);
            },
            options, on_iteration);
    }
    // Refines the window's part of the map and says in it what took part.
    Result solve_window(const Context& context, Window& window, const SolverOptions& options = {},
                        const IterationCallback& on_iteration = {}) {
        return solve_by(
            [&](const clba_solver_options& given, clba_result** made) {
                return clba_problem_solve_window(object_, context.get(), &given, &window.fill(),
                                                 made);
            },
            options, on_iteration);
    }

    // -- Covariances and gauge

    // Of all poses and intrinsics, and of the points that the options ask for.
    Covariance covariance(const Context& context, const CovarianceOptions& options = {}) {
        clba_covariance* made = nullptr;
        check(clba_problem_covariance(object_, context.get(), &options, &made));
        return Covariance(made);
    }
    void fix_gauge(const GaugeTarget& target) { check(clba_problem_fix_gauge(object_, &target)); }

    // -- Evaluating

    void evaluate(const Context& context, clba_evaluation& evaluation) {
        check(clba_problem_evaluate(object_, context.get(), &evaluation));
    }
    // With residuals, gradient and Jacobian.
    Evaluation evaluate(const Context& context, int32_t precision = CLBA_PRECISION_DOUBLE,
                        bool apply_loss = true) {
        const ProblemInfo sizes = info();
        const auto rows = 2 * static_cast<size_t>(sizes.num_observations);
        const auto columns = static_cast<size_t>(sizes.num_parameters_per_image_block);
        Evaluation evaluation;
        evaluation.residuals.resize(rows);
        evaluation.gradient.resize(static_cast<size_t>(sizes.num_parameters));
        evaluation.jacobian_images.resize(rows * columns);
        evaluation.jacobian_points.resize(rows * 3);
        EvaluationRequest request;
        request.precision = precision;
        request.apply_loss = apply_loss;
        request.residuals = evaluation.residuals.data();
        request.gradient = evaluation.gradient.data();
        request.jacobian_images = evaluation.jacobian_images.data();
        request.jacobian_points = evaluation.jacobian_points.data();
        evaluate(context, request);
        evaluation.cost = request.cost;
        evaluation.num_behind = request.num_behind;
        evaluation.num_singular = request.num_singular;
        return evaluation;
    }
    Offsets offsets() const {
        const ProblemInfo sizes = info();
        Offsets offsets{std::vector<int64_t>(static_cast<size_t>(sizes.num_images)),
                        std::vector<int64_t>(static_cast<size_t>(sizes.num_cameras))};
        check(clba_problem_get_offsets(object_, offsets.poses.data(), offsets.intrinsics.data()));
        return offsets;
    }
    // product: CLBA_PRODUCT_...; y gets the size of the result and keeps its memory if it can.
    void multiply(const Context& context, int32_t product, const std::vector<double>& x,
                  std::vector<double>& y, int32_t precision = CLBA_PRECISION_DOUBLE,
                  double lambda = 0) {
        const ProblemInfo sizes = info();
        const int64_t rows = 2 * sizes.num_observations, columns = sizes.num_parameters;
        const bool takes_rows = product == CLBA_PRODUCT_JTY;
        const bool gives_rows = product == CLBA_PRODUCT_JX;
        detail::require_equal(static_cast<int64_t>(x.size()), takes_rows ? rows : columns,
                              "numbers in x", "are needed");
        detail::require(&x != &y, "x and y are one vector, but must be two");
        y.resize(static_cast<size_t>(gives_rows ? rows : columns));
        check(clba_problem_multiply(object_, context.get(), product, precision, lambda, x.data(),
                                    y.data()));
    }
    void apply_step(Rows<const double, 1> step) {
        detail::require_equal(step.count(), info().num_parameters, "numbers in the step",
                              "are needed");
        detail::require(step.stride() == 0 || step.stride() == sizeof(double),
                        "the step has gaps, but must not have any");
        check(clba_problem_apply_step(object_, step.data()));
    }

private:
    template <class Callback>
    struct Call {
        const Callback& callback;
        std::exception_ptr thrown;

        static int32_t enter(const clba_iteration* row, void* user_data) noexcept {
            return run(*row, user_data);
        }
        static int32_t enter(double fraction, void* user_data) noexcept {
            return run(fraction, user_data);
        }
        template <class Argument>
        static int32_t run(const Argument& argument, void* user_data) noexcept {
            Call& call = *static_cast<Call*>(user_data);
            try {
                return call.callback(argument) == Next::stop;
            } catch (...) {
                call.thrown = std::current_exception();
                return 1;
            }
        }
    };

    template <class Run>
    static Result solve_by(Run&& run, const SolverOptions& options,
                           const IterationCallback& on_iteration) {
        clba_solver_options given = options;
        Call<IterationCallback> call{on_iteration, nullptr};
        if (on_iteration) {
            given.on_iteration = &Call<IterationCallback>::enter;
            given.user_data = &call;
        }
        clba_result* made = nullptr;
        const clba_status status = run(given, &made);
        Result result(made);
        if (call.thrown) std::rethrow_exception(call.thrown);
        check(status);
        return result;
    }
    template <class Run>
    Removed remove(Run&& run) {
        const ProblemInfo before = info();
        Removed removed{detail::sized<clba_filter_report>(),
                        std::vector<int64_t>(static_cast<size_t>(before.num_observations)),
                        std::vector<int32_t>(static_cast<size_t>(before.num_points)),
                        std::vector<int32_t>(static_cast<size_t>(before.num_images))};
        removed.counts.observation_rows = removed.observation_rows.data();
        removed.counts.point_rows = removed.point_rows.data();
        removed.counts.unobserved_images = removed.unobserved_images.data();
        check(run(removed.counts));
        removed.counts.observation_rows = nullptr;
        removed.counts.point_rows = removed.counts.unobserved_images = nullptr;
        return removed;
    }

    static int32_t value(Rows<const int32_t, 1> rows, int64_t i) {
        const size_t stride = rows.stride() ? rows.stride() : sizeof(int32_t);
        int32_t value;
        std::memcpy(&value,
                    reinterpret_cast<const char*>(rows.data()) + static_cast<size_t>(i) * stride,
                    sizeof value);
        return value;
    }
    template <class Set, class Subjects, class Targets, class Covariances>
    void set_priors(Set* set, const Subjects& subjects, const Targets& targets,
                    const Covariances& covariances) {
        detail::require_equal(targets.count(), subjects.count(), "targets", "priors");
        detail::require_equal(covariances.count(), subjects.count(), "covariances", "priors");
        check(set(object_, detail::count32(subjects.count(), "priors"), subjects.data(),
                  subjects.stride(), targets.data(), targets.stride(), covariances.data(),
                  covariances.stride()));
    }
    static int64_t num_params(const std::vector<int32_t>& models) {
        int64_t sum = 0;
        for (const int32_t model : models) sum += camera_model_num_params(model);
        return sum;
    }
    std::vector<int32_t> camera_models() const {
        std::vector<int32_t> models(static_cast<size_t>(info().num_cameras));
        check(clba_problem_get_cameras(object_, 0, static_cast<int32_t>(models.size()),
                                       models.data(), 0, nullptr, 0));
        return models;
    }
};

// ---- Comparing and generating -------------------------------------------------------------------

// b is aligned to a.
inline Comparison compare(const Problem& a, const Problem& b) {
    auto comparison = detail::sized<Comparison>();
    check(clba_problem_compare(a.get(), b.get(), &comparison));
    return comparison;
}

struct Scene {
    Problem start, truth;
};
inline Scene generate(const SceneOptions& options = {}) {
    clba_problem *start = nullptr, *truth = nullptr;
    check(clba_problem_generate(&options, &start, &truth));
    return {Problem(start), Problem(truth)};
}

}  // namespace clba
#endif  // CLBA_CLBA_HPP
