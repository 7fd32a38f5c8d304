// SPDX-License-Identifier: Apache-2.0
#include "io/bal.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

#include "base/error.hpp"
#include "io/bal_parallel.hpp"
#include "io/number_reader.hpp"
#include "io/text_output.hpp"

namespace clba {
namespace {

constexpr int64_t large_file_bytes = int64_t{1} << 20;
constexpr size_t window_bytes = size_t{1} << 24;

// False: its rotation is not finite.
bool add_image(const std::array<double, 9>& values, Problem& problem, RotationVectors* rotations) {
    const std::array<double, 3> rotation = {values[0], values[1], values[2]};
    if (rotations) rotations->push_back(rotation);
    Image image;
    image.camera = problem.num_cameras();
    image.pose.rotation = quaternion_from_rotation_vector(rotation);
    image.pose.translation = {values[3], values[4], values[5]};
    Camera camera;
    camera.model = camera_snavely;
    std::copy(values.begin() + 6, values.end(), camera.params.begin());
    problem.images.push_back(image);
    problem.cameras.push_back(camera);
    return std::isfinite(image.pose.rotation[0]);
}

void read_image(NumberReader& numbers, int64_t index, int64_t count, Problem& problem,
                RotationVectors* rotations) {
    static constexpr const char* names[] = {"rotation vector's x",
                                            "rotation vector's y",
                                            "rotation vector's z",
                                            "translation's x",
                                            "translation's y",
                                            "translation's z",
                                            "focal length f",
                                            "k1",
                                            "k2"};
    std::array<double, 9> values;
    for (size_t k = 0; k < 9; ++k) values[k] = numbers.number({names[k], "image", index, count});
    if (!add_image(values, problem, rotations))
        numbers.fail_here("the rotation vector of image ", index, " is (", values[0], ", ",
                          values[1], ", ", values[2], "), but its squared length must be finite");
}

Problem read_number_by_number(const std::string& path, RotationVectors* rotations) {
    constexpr int32_t most_rows = std::numeric_limits<int32_t>::max();
    NumberReader numbers(path, "a BAL file", "num_images num_points num_observations");
    const auto num_images = static_cast<int32_t>(numbers.count({"num_images"}, most_rows));
    const auto num_points = static_cast<int32_t>(numbers.count({"num_points"}, most_rows));
    const int64_t num_observations =
        numbers.count({"num_observations"}, std::numeric_limits<int64_t>::max());

    const int64_t file_bytes = size_of_file(path);
    Problem problem;
    reserve(problem.observations, num_observations, file_bytes, 8);
    for (int64_t i = 0; i < num_observations; ++i) {
        const char* const row = "observation";
        Observation o;
        o.image =
            numbers.index({"image index", row, i, num_observations}, "num_images", num_images);
        o.point =
            numbers.index({"point index", row, i, num_observations}, "num_points", num_points);
        o.x = numbers.number({"x", row, i, num_observations});
        o.y = numbers.number({"y", row, i, num_observations});
        problem.observations.push_back(o);
    }
    reserve(problem.images, num_images, file_bytes, 18);
    reserve(problem.cameras, num_images, file_bytes, 18);
    if (rotations) rotations->clear();
    for (int32_t i = 0; i < num_images; ++i) read_image(numbers, i, num_images, problem, rotations);
    reserve(problem.points, num_points, file_bytes, 6);
    for (int32_t i = 0; i < num_points; ++i) {
        const double x = numbers.number({"x", "point", i, num_points});
        const double y = numbers.number({"y", "point", i, num_points});
        const double z = numbers.number({"z", "point", i, num_points});
        problem.points.push_back({x, y, z});
    }
    numbers.expect_end(num_points > 0   ? "the last point"
                       : num_images > 0 ? "the last image"
                                        : "the last observation");
    return problem;
}

}  // namespace

Problem read_bal(const std::string& path, RotationVectors* rotations) {
    BalNumbers numbers;
    if (size_of_file(path) < large_file_bytes || !read_bal_in_parallel(path, window_bytes, numbers))
        return read_number_by_number(path, rotations);
    Problem problem;
    problem.observations = std::move(numbers.observations);
    problem.points = std::move(numbers.points);
    for (const std::array<double, 9>& image : numbers.images)
        if (!add_image(image, problem, rotations)) return read_number_by_number(path, rotations);
    return problem;
}

void write_bal(const Problem& problem, const std::string& path, const RotationVectors* rotations) {
    for (size_t i = 0; i < problem.cameras.size(); ++i)
        require(problem.cameras[i].model == camera_snavely, "cameras[", i, "] is a ",
                camera_models[problem.cameras[i].model].name,
                " camera, but BAL files hold snavely cameras only");
    TextOutput output(path);
    const auto put_line = [&output](double value) {
        output.put(value);
        output.put("\n");
    };
    output.put(int64_t{problem.num_images()});
    output.put(" ");
    output.put(int64_t{problem.num_points()});
    output.put(" ");
    output.put(problem.num_observations());
    output.put("\n");
    for (const Observation& o : problem.observations) {
        output.put(int64_t{o.image});
        output.put(" ");
        output.put(int64_t{o.point});
        output.put(" ");
        output.put(o.x);
        output.put(" ");
        put_line(o.y);
    }
    for (size_t i = 0; i < problem.images.size(); ++i) {
        const Image& image = problem.images[i];
        const bool keeps_vector =
            rotations && i < rotations->size() &&
            quaternion_from_rotation_vector((*rotations)[i]) == image.pose.rotation;
        const auto vector =
            keeps_vector ? (*rotations)[i] : rotation_vector_from_quaternion(image.pose.rotation);
        for (double value : vector) put_line(value);
        for (double value : image.pose.translation) put_line(value);
        const Camera& camera = problem.cameras[image.camera];
        for (int k = 0; k < camera.num_params(); ++k) put_line(camera.params[k]);
    }
    for (const Point& point : problem.points)
        for (double value : point) put_line(value);
    output.commit();
}

}  // namespace clba
