// SPDX-License-Identifier: Apache-2.0
#include "io/nvm.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

#include "base/error.hpp"
#include "io/camera_forms.hpp"
#include "io/convert.hpp"
#include "io/number_reader.hpp"
#include "io/nvm_distortion.hpp"
#include "io/text_output.hpp"
#include "problem/counting_sort.hpp"

namespace clba {
namespace {

// A camera as the file has it.
struct FileCamera {
    double focal = 0;
    std::array<double, 4> rotation{1, 0, 0, 0};
    std::array<double, 3> center{0, 0, 0};
    double distortion = 0;

    Pose pose() const {
        Pose pose;
        pose.rotation = normalized(rotation);
        pose.translation = translation_from_center(pose.rotation, center);
        return pose;
    }
};

struct NvmDetails final : SourceDetails {
    NvmDetails() : SourceDetails("nvm") {}
    std::string calibration;  // "FixedK" and its numbers, or empty
    std::vector<FileCamera> cameras;
    std::vector<double> radius;  // |measured| / f of each camera's outermost measurement
    std::string rest;            // all that follows the model
};

Camera camera_of(const FileCamera& read, double radius) {
    Camera camera;
    camera.model = read.distortion == 0 ? camera_simple_pinhole : camera_simple_radial;
    camera.params[0] = read.focal;
    if (read.distortion != 0) camera.params[3] = radial_from_measured(read.distortion, radius);
    return camera;
}

FileCamera read_camera(NumberReader& numbers, int32_t index, int32_t count) {
    static constexpr const char* names[] = {
        "focal length", "rotation's w", "rotation's x", "rotation's y",      "rotation's z",
        "centre's x",   "centre's y",   "centre's z",   "radial distortion", "last number"};
    double values[10];
    for (int k = 0; k < 10; ++k) values[k] = numbers.number({names[k], "camera", index, count});
    FileCamera camera;
    camera.focal = values[0];
    if (camera.focal == 0)
        numbers.fail_here("the focal length of camera ", index, " is 0, but it must be another");
    std::copy(values + 1, values + 5, camera.rotation.begin());
    double norm = 0;
    for (double value : camera.rotation) norm += value * value;
    if (!(norm > 1e-12) || !std::isfinite(norm))
        numbers.fail_here("the rotation of camera ", index, " is the quaternion (", values[1], ", ",
                          values[2], ", ", values[3], ", ", values[4],
                          "), but its length must be positive and finite");
    std::copy(values + 5, values + 8, camera.center.begin());
    camera.distortion = values[8];
    if (values[9] != 0)
        numbers.fail_here("the last number of camera ", index, " is ", values[9],
                          ", but it must be 0; only version NVM_V3 is read");
    for (double value : camera.pose().translation)
        if (!std::isfinite(value))
            numbers.fail_here("the centre of camera ", index, " is too far away for its rotation");
    return camera;
}

void read_points(NumberReader& numbers, int32_t num_points, int64_t file_bytes, NvmDetails& details,
                 Reconstruction& result) {
    static constexpr const char* const names[] = {"x", "y", "z"};
    static constexpr const char* const color_names[] = {"red", "green", "blue"};
    constexpr int32_t most = std::numeric_limits<int32_t>::max();
    reserve(result.problem.points, num_points, file_bytes, 14);
    reserve(result.points, num_points, file_bytes, 14);
    for (int32_t p = 0; p < num_points; ++p) {
        Point point;
        for (int k = 0; k < 3; ++k) point[k] = numbers.number({names[k], "point", p, num_points});
        PointInfo info;
        info.id = static_cast<uint64_t>(p);
        for (int k = 0; k < 3; ++k)
            info.color[k] = static_cast<uint8_t>(
                numbers.integer({color_names[k], "point", p, num_points}, 0, 255));
        const int64_t num_measurements =
            numbers.count({"number of measurements", "point", p, num_points}, most);
        for (int64_t i = 0; i < num_measurements; ++i) {
            Observation o;
            o.image = numbers.index({"image index", "point", p, num_points},
                                    "the number of cameras", result.problem.num_images());
            o.point = p;
            result.observation_features.push_back(static_cast<int32_t>(
                numbers.integer({"feature index", "point", p, num_points}, -1, most)));
            o.x = numbers.number({"measurement's x", "point", p, num_points});
            o.y = numbers.number({"measurement's y", "point", p, num_points});
            double& radius = details.radius[o.image];
            radius =
                std::max(radius, std::hypot(o.x, o.y) / std::abs(details.cameras[o.image].focal));
            result.problem.observations.push_back(o);
        }
        result.problem.points.push_back(point);
        result.points.push_back(info);
    }
}

void make_cameras(const NumberReader& numbers, const NvmDetails& details, Reconstruction& result) {
    int32_t num_distorted = 0;
    double worst = 0;
    std::string worst_name;
    for (size_t i = 0; i < details.cameras.size(); ++i) {
        const FileCamera& read = details.cameras[i];
        const Camera camera = camera_of(read, details.radius[i]);
        if (!std::isfinite(camera.params[3]))
            fail(Status::format, numbers.path(), ": camera ", i, " has the radial distortion ",
                 read.distortion, ", which is too strong for its measurements");
        result.problem.cameras.push_back(camera);
        if (camera.model == camera_simple_pinhole) continue;
        ++num_distorted;
        const double pixels =
            std::abs(read.focal) *
            distortion_difference(read.distortion, camera.params[3], details.radius[i]);
        if (pixels < worst) continue;
        worst = pixels;
        worst_name = result.images[i].name;
    }
    if (num_distorted > 0)
        result.notices.push_back(
            text(num_distorted, " of ", details.cameras.size(),
                 " cameras have a radial distortion, which VisualSFM applies to measurements and "
                 "clba to "
                 "projections; the closest simple_radial cameras differ by at most ",
                 worst, " pixels, in ", worst_name));
    if (!details.calibration.empty())
        for (const Camera& camera : result.problem.cameras)
            result.problem.constant_cameras.push_back((1u << camera.num_params()) - 1);
}

struct WrittenCamera {
    FileCamera file;
    double cx = 0, cy = 0;
};

BrownForm form_of(const Camera& camera, int32_t index) {
    const std::optional<BrownForm> form = brown_form(camera);
    require(form && form->fx == form->fy && form->k2 == 0 && form->p1 == 0 && form->p2 == 0 &&
                form->k3 == 0 && form->fx != 0,
            "cameras[", index, "] is a ", camera_models[camera.model].name,
            " camera that NVM files cannot hold: these have one focal length and one radial "
            "distortion; solve with simple_pinhole or simple_radial, or write another format");
    return *form;
}

WrittenCamera written_camera(const Problem& problem, int32_t index, double radius,
                             const FileCamera* read, double read_radius) {
    const Image& image = problem.images[index];
    const Camera& camera = problem.cameras[image.camera];
    const BrownForm form = form_of(camera, image.camera);
    WrittenCamera written{{}, form.cx, form.cy};
    if (read) {
        const Camera as_read = camera_of(*read, read_radius);
        const Pose pose = read->pose();
        written.file = *read;
        if (pose.rotation != image.pose.rotation) written.file.rotation = image.pose.rotation;
        if (pose.rotation != image.pose.rotation || pose.translation != image.pose.translation)
            written.file.center = camera_center(image.pose);
        if (as_read.model == camera.model && as_read.params == camera.params) return written;
    } else {
        written.file.rotation = image.pose.rotation;
        written.file.center = camera_center(image.pose);
    }
    written.file.focal = form.fx;
    if (form.k1 == 0) {
        written.file.distortion = 0;
        return written;
    }
    const std::optional<double> distortion = measured_from_radial(form.k1, radius);
    const double pixels =
        distortion ? std::abs(form.fx) * distortion_difference(*distortion, form.k1, radius)
                   : std::numeric_limits<double>::infinity();
    require(pixels <= 1, "cameras[", image.camera, "] has the distortion k1 = ", form.k1,
            ", and the closest one that NVM files can hold moves an observation of images[", index,
            "] by ", pixels, " pixels, more than 1; write another format");
    written.file.distortion = *distortion;
    return written;
}

// The outermost observation of each image in units of its focal length.
std::vector<double> radii(const Problem& problem) {
    std::vector<double> radius(problem.images.size(), 0);
    for (const Observation& o : problem.observations) {
        const std::optional<BrownForm> form =
            brown_form(problem.cameras[problem.images[o.image].camera]);
        if (!form || form->fx == 0) continue;
        double& most = radius[o.image];
        most = std::max(most, std::hypot(o.x - form->cx, o.y - form->cy) / std::abs(form->fx));
    }
    return radius;
}

std::string name_of(const Reconstruction& reconstruction, int32_t image) {
    std::string name = reconstruction.images.empty() ? "" : reconstruction.images[image].name;
    if (name.empty()) return text("image", image);
    for (char c : name)
        require(
            (c < '\t' || c > '\r') && c != '"', "the name of images[", image, "], '", shown(name),
            "', has a line break, a tab or a quotation mark in it, which NVM files cannot hold");
    std::replace(name.begin(), name.end(), ' ', '"');  // as VisualSFM does
    return name;
}

template <class Values>
void put_numbers(TextOutput& output, const Values& values) {
    for (double value : values) {
        output.put(" ");
        output.put(value);
    }
}

}  // namespace

Reconstruction read_nvm(const std::string& path) {
    constexpr int32_t most = std::numeric_limits<int32_t>::max();
    NumberReader numbers(path, "an NVM file", "NVM_V3");
    numbers.expect({"first word"}, "NVM_V3");
    auto details = std::make_shared<NvmDetails>();
    std::string first(numbers.word({"the number of cameras"}));
    if (first == "FixedK") {
        details->calibration = "FixedK";
        for (const char* name : {"fx", "cx", "fy", "cy"}) {
            details->calibration += ' ';
            details->calibration += numbers.word({name});
            double value;
            if (!parse_number(details->calibration.substr(details->calibration.rfind(' ') + 1),
                              value))
                numbers.fail_here(name, " of FixedK must be a number");
        }
        first = numbers.word({"the number of cameras"});
    }
    int64_t count = 0;
    if (parse_integer(first, count) != IntegerParse::ok || count < 0 || count > most)
        numbers.fail_here("the number of cameras is '", shown(first),
                          "', but it must be an integer from 0 to ", most);
    const auto num_cameras = static_cast<int32_t>(count);
    Reconstruction result;
    for (int32_t i = 0; i < num_cameras; ++i) {
        ImageInfo info;
        info.id = static_cast<uint64_t>(i);
        info.name = numbers.word({"name", "camera", i, num_cameras});
        std::replace(info.name.begin(), info.name.end(), '"', ' ');
        result.images.push_back(info);
        details->cameras.push_back(read_camera(numbers, i, num_cameras));
        details->radius.push_back(0);
        Image image;
        image.camera = i;
        image.pose = details->cameras.back().pose();
        result.problem.images.push_back(image);
    }
    int32_t num_points = 0;
    if (num_cameras > 0) {
        num_points = static_cast<int32_t>(numbers.count({"the number of points"}, most));
        read_points(numbers, num_points, size_of_file(path), *details, result);
    }
    make_cameras(numbers, *details, result);
    details->rest = numbers.rest();
    const size_t line_end = details->rest.find('\n');
    if (details->rest.find_first_not_of(" \t\r") == line_end && line_end != std::string::npos)
        details->rest.erase(0, line_end + 1);
    const size_t next = details->rest.find_first_not_of(" \t\r\n");
    if (num_cameras > 0 && next != std::string::npos && details->rest[next] >= '1' &&
        details->rest[next] <= '9')
        result.notices.push_back(
            "the first model was read; the file's other models and images are kept as they are");
    result.details = std::move(details);
    return result;
}

void require_nvm_cameras(const Problem& problem) {
    for (const Image& image : problem.images) {
        const Camera& camera = problem.cameras[image.camera];
        if (camera.model == camera_snavely)
            form_of({camera_radial, {camera.params[0], 0, 0, camera.params[1], camera.params[2]}},
                    image.camera);
        else
            form_of(camera, image.camera);
    }
}

void write_nvm(const Reconstruction& reconstruction, const std::string& path) {
    if (has_snavely_cameras(reconstruction.problem)) {
        write_nvm(with_pixel_cameras(reconstruction), path);
        return;
    }
    const Problem& problem = reconstruction.problem;
    const auto* read = dynamic_cast<const NvmDetails*>(reconstruction.details.get());
    if (read && read->cameras.size() != problem.images.size()) read = nullptr;
    require(problem.num_observations() <= std::numeric_limits<int32_t>::max(), "there are ",
            problem.num_observations(), " observations, but at most 2^31 - 1 can be written");
    require(problem.num_images() > 0 || problem.num_points() == 0, "there are ",
            problem.num_points(), " points, but NVM files without images hold none");
    const std::vector<double> radius = radii(problem);
    std::vector<WrittenCamera> cameras;
    for (int32_t i = 0; i < problem.num_images(); ++i)
        cameras.push_back(written_camera(problem, i, radius[i], read ? &read->cameras[i] : nullptr,
                                         read ? read->radius[i] : 0));
    TextOutput output(path);
    output.put("NVM_V3");
    if (read && !read->calibration.empty()) {
        output.put(" ");
        output.put(read->calibration);
    }
    output.put("\n\n");
    output.put(int64_t{problem.num_images()});
    output.put("\n");
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        output.put(name_of(reconstruction, i));
        const FileCamera& camera = cameras[i].file;
        output.put("\t");
        output.put(camera.focal);
        put_numbers(output, camera.rotation);
        put_numbers(output, camera.center);
        output.put(" ");
        output.put(camera.distortion);
        output.put(" 0\n");
    }
    if (problem.num_images() > 0) {
        output.put("\n");
        output.put(int64_t{problem.num_points()});
        output.put("\n");
    }
    std::vector<int32_t> by_point(problem.observations.size());
    const std::vector<int32_t> begin = counting_sort(
        problem.num_observations(), problem.num_points(),
        [&](int64_t i) { return problem.observations[i].point; },
        [&](int64_t i, int32_t slot) { by_point[slot] = static_cast<int32_t>(i); });
    std::vector<int32_t> next_feature(problem.images.size(), 0);
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        for (double value : problem.points[p]) {
            output.put(value);
            output.put(" ");
        }
        const PointInfo info =
            reconstruction.points.empty() ? PointInfo{} : reconstruction.points[p];
        for (uint8_t value : info.color) {
            output.put(int64_t{value});
            output.put(" ");
        }
        output.put(int64_t{begin[p + 1] - begin[p]});
        for (int32_t i = begin[p]; i < begin[p + 1]; ++i) {
            const Observation& o = problem.observations[by_point[i]];
            const WrittenCamera& camera = cameras[o.image];
            output.put(" ");
            output.put(int64_t{o.image});
            output.put(" ");
            output.put(int64_t{reconstruction.observation_features.empty()
                                   ? next_feature[o.image]++
                                   : reconstruction.observation_features[by_point[i]]});
            output.put(" ");
            output.put(o.x - camera.cx);
            output.put(" ");
            output.put(o.y - camera.cy);
        }
        output.put("\n");
    }
    if (read && !read->rest.empty())
        output.put(read->rest);
    else
        output.put("\n0\n");
    output.commit();
}

}  // namespace clba
