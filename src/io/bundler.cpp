// SPDX-License-Identifier: Apache-2.0
#include "io/bundler.hpp"

#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>

#include "base/error.hpp"
#include "io/camera_forms.hpp"
#include "io/convert.hpp"
#include "io/number_reader.hpp"
#include "io/text_output.hpp"
#include "problem/counting_sort.hpp"

namespace clba {
namespace {

using Matrix = std::array<double, 9>;

struct FileCamera {
    std::array<double, 3> intrinsics;  // f, k1, k2
    Matrix rotation;
    std::array<double, 3> translation;
};

struct BundlerDetails final : SourceDetails {
    BundlerDetails() : SourceDetails("bundler") {}
    std::vector<int32_t> image_of_camera;  // -1: not reconstructed
    std::vector<FileCamera> cameras;
    std::vector<std::string> list;  // of names, or empty
};

FileCamera read_camera(NumberReader& numbers, int64_t index, int64_t count) {
    static constexpr const char* names[] = {"focal length f",
                                            "k1",
                                            "k2",
                                            "rotation's 1st number",
                                            "rotation's 2nd number",
                                            "rotation's 3rd number",
                                            "rotation's 4th number",
                                            "rotation's 5th number",
                                            "rotation's 6th number",
                                            "rotation's 7th number",
                                            "rotation's 8th number",
                                            "rotation's 9th number",
                                            "translation's x",
                                            "translation's y",
                                            "translation's z"};
    double values[15];
    for (int k = 0; k < 15; ++k) values[k] = numbers.number({names[k], "camera", index, count});
    FileCamera camera;
    std::copy(values, values + 3, camera.intrinsics.begin());
    std::copy(values + 3, values + 12, camera.rotation.begin());
    std::copy(values + 12, values + 15, camera.translation.begin());
    return camera;
}

// A line "name", or "name 0 focal_length".
std::string name_in(const std::string& line) {
    double value;
    const auto last_word = [](const std::string& words) {
        const size_t space = words.find_last_of(" \t");
        return space == std::string::npos ? 0 : space + 1;
    };
    const size_t focal = last_word(line);
    if (focal == 0 || !parse_number(line.substr(focal), value)) return line;
    const std::string before = line.substr(0, line.find_last_not_of(" \t", focal - 1) + 1);
    const size_t zero = last_word(before);
    if (zero == 0 || before.substr(zero) != "0") return line;
    return before.substr(0, before.find_last_not_of(" \t", zero - 1) + 1);
}

std::string own_list_path(const std::string& path) {
    std::string stem = path;
    for (const char* ending : {".gz", ".bz2", ".out"}) {
        const size_t length = std::string_view(ending).size();
        if (stem.size() > length && stem.compare(stem.size() - length, length, ending) == 0)
            stem.resize(stem.size() - length);
    }
    return stem + ".list.txt";
}

std::vector<std::string> read_list(const std::string& path, size_t num_cameras) {
    const std::filesystem::path folder = std::filesystem::path(path).parent_path();
    for (const std::string& candidate : {own_list_path(path), (folder / "list.txt").string()}) {
        std::error_code error;
        if (!std::filesystem::is_regular_file(candidate, error)) continue;
        std::vector<std::string> list;
        LineReader lines(candidate);
        for (std::string_view line; lines.next(line);)
            if (line.find_first_not_of(" \t") != std::string_view::npos) list.emplace_back(line);
        if (list.size() != num_cameras)
            fail(Status::format, candidate, " names ", list.size(), " images, but ", path,
                 " beside it has ", num_cameras,
                 " cameras; they must belong together, or be in different folders");
        return list;
    }
    return {};
}

void read_points(NumberReader& numbers, int32_t num_points, int64_t file_bytes,
                 const std::vector<int32_t>& image_of_camera, Reconstruction& result) {
    static constexpr const char* const names[] = {"x", "y", "z"};
    static constexpr const char* const color_names[] = {"red", "green", "blue"};
    constexpr int32_t most = std::numeric_limits<int32_t>::max();
    const auto num_cameras = static_cast<int32_t>(image_of_camera.size());
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
        const int64_t num_views = numbers.count({"number of views", "point", p, num_points}, most);
        for (int64_t i = 0; i < num_views; ++i) {
            const int32_t camera = numbers.index({"camera index", "point", p, num_points},
                                                 "the number of cameras", num_cameras);
            if (image_of_camera[camera] < 0)
                numbers.fail_here("point ", p, " is seen by camera ", camera,
                                  ", but that has f = 0: it was not reconstructed");
            Observation o;
            o.image = image_of_camera[camera];
            o.point = p;
            result.observation_features.push_back(
                static_cast<int32_t>(numbers.integer({"key", "point", p, num_points}, -1, most)));
            o.x = numbers.number({"view's x", "point", p, num_points});
            o.y = numbers.number({"view's y", "point", p, num_points});
            result.problem.observations.push_back(o);
        }
        result.problem.points.push_back(point);
        result.points.push_back(info);
    }
}

FileCamera file_camera(const Problem& problem, int32_t index) {
    const Image& image = problem.images[index];
    const auto& p = problem.cameras[image.camera].params;
    require(p[0] != 0, "cameras[", image.camera,
            "] has a focal length of 0, which marks a camera as unused in Bundler files");
    return {{p[0], p[1], p[2]}, rotation_matrix(image.pose.rotation), image.pose.translation};
}

void put_numbers(TextOutput& output, const double* values, int count) {
    for (int k = 0; k < count; ++k) {
        output.put(values[k]);
        output.put(k + 1 < count ? " " : "\n");
    }
}

void put_camera(TextOutput& output, const FileCamera& camera) {
    put_numbers(output, camera.intrinsics.data(), 3);
    for (int row = 0; row < 3; ++row) put_numbers(output, camera.rotation.data() + 3 * row, 3);
    put_numbers(output, camera.translation.data(), 3);
}

// Of the images' names, if there are any.
std::vector<std::string> new_list(const Reconstruction& reconstruction) {
    std::vector<std::string> list;
    bool has_names = false;
    for (size_t i = 0; i < reconstruction.images.size(); ++i) {
        const std::string& name = reconstruction.images[i].name;
        list.push_back(name.empty() ? text("image", i) : name);
        has_names |= !name.empty();
        require(name_in(name) == name && name.find_first_of("\r\n") == std::string::npos &&
                    list.back().find_first_not_of(" \t") != std::string::npos,
                "the name of images[", i, "], '", shown(name),
                "', cannot stand in a list of images: it is blank, has a line break in it, or ends "
                "like a focal length");
    }
    return has_names ? list : std::vector<std::string>();
}

// The cameras of the file that was read, if the problem still has its images; else one an image.
BundlerDetails details_of(const Reconstruction& reconstruction, const Problem& problem) {
    const int32_t num_images = problem.num_images();
    BundlerDetails details;
    const auto* read = dynamic_cast<const BundlerDetails*>(reconstruction.details.get());
    if (read) {
        int32_t used = 0;
        for (int32_t image : read->image_of_camera) used += image >= 0;
        if (used == num_images) details = *read;
    }
    if (details.image_of_camera.empty()) {
        details.cameras.resize(num_images);
        for (int32_t i = 0; i < num_images; ++i) details.image_of_camera.push_back(i);
        details.list = new_list(reconstruction);
    }
    for (size_t c = 0; c < details.cameras.size(); ++c) {
        const int32_t image = details.image_of_camera[c];
        if (image < 0) continue;
        FileCamera& camera = details.cameras[c];
        const bool keeps_matrix =
            read && quaternion_from_matrix(camera.rotation) == problem.images[image].pose.rotation;
        const Matrix matrix = camera.rotation;
        camera = file_camera(problem, image);
        if (keeps_matrix) camera.rotation = matrix;
    }
    return details;
}

void put_points(TextOutput& output, const Reconstruction& reconstruction, const Problem& problem,
                const std::vector<int32_t>& camera_of_image) {
    require(problem.num_observations() <= std::numeric_limits<int32_t>::max(), "there are ",
            problem.num_observations(), " observations, but at most 2^31 - 1 can be written");
    std::vector<int32_t> by_point(problem.observations.size());
    const std::vector<int32_t> begin = counting_sort(
        problem.num_observations(), problem.num_points(),
        [&](int64_t i) { return problem.observations[i].point; },
        [&](int64_t i, int32_t slot) { by_point[slot] = static_cast<int32_t>(i); });
    std::vector<int32_t> next_key(problem.images.size(), 0);
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        put_numbers(output, problem.points[p].data(), 3);
        const PointInfo info =
            reconstruction.points.empty() ? PointInfo{} : reconstruction.points[p];
        for (int k = 0; k < 3; ++k) {
            output.put(int64_t{info.color[k]});
            output.put(k < 2 ? " " : "\n");
        }
        output.put(int64_t{begin[p + 1] - begin[p]});
        for (int32_t i = begin[p]; i < begin[p + 1]; ++i) {
            const Observation& o = problem.observations[by_point[i]];
            output.put(" ");
            output.put(int64_t{camera_of_image[o.image]});
            output.put(" ");
            output.put(int64_t{reconstruction.observation_features.empty()
                                   ? next_key[o.image]++
                                   : reconstruction.observation_features[by_point[i]]});
            output.put(" ");
            output.put(o.x);
            output.put(" ");
            output.put(o.y);
        }
        output.put("\n");
    }
}

}  // namespace

Reconstruction read_bundler(const std::string& path) {
    constexpr int32_t most = std::numeric_limits<int32_t>::max();
    NumberReader numbers(path, "a Bundler file", "'# Bundle file v0.3'");
    numbers.expect({"first word"}, "#");
    numbers.expect({"second word"}, "Bundle");
    numbers.expect({"third word"}, "file");
    numbers.expect({"version"}, "v0.3");
    const auto num_cameras = static_cast<int32_t>(numbers.count({"the number of cameras"}, most));
    const auto num_points = static_cast<int32_t>(numbers.count({"the number of points"}, most));

    Reconstruction result;
    auto details = std::make_shared<BundlerDetails>();
    for (int32_t c = 0; c < num_cameras; ++c) {
        const FileCamera read = read_camera(numbers, c, num_cameras);
        details->cameras.push_back(read);
        if (read.intrinsics[0] == 0) {
            details->image_of_camera.push_back(-1);
            continue;
        }
        if (!is_rotation(read.rotation))
            numbers.fail_here("the rotation of camera ", c,
                              " is no rotation: its rows must have length 1 and right angles to "
                              "1e-3, and a positive determinant");
        Image image;
        image.camera = result.problem.num_cameras();
        image.pose.rotation = quaternion_from_matrix(read.rotation);
        image.pose.translation = read.translation;
        Camera camera;
        camera.model = camera_snavely;
        std::copy(read.intrinsics.begin(), read.intrinsics.end(), camera.params.begin());
        details->image_of_camera.push_back(result.problem.num_images());
        result.problem.images.push_back(image);
        result.problem.cameras.push_back(camera);
        ImageInfo info;
        info.id = static_cast<uint64_t>(c);
        result.images.push_back(info);
    }
    read_points(numbers, num_points, size_of_file(path), details->image_of_camera, result);
    numbers.expect_end(num_points > 0 ? "the last point" : "the last camera");

    details->list = read_list(path, details->cameras.size());
    if (!details->list.empty())
        for (ImageInfo& image : result.images) image.name = name_in(details->list[image.id]);
    const int64_t unused = num_cameras - result.problem.num_images();
    if (unused > 0)
        result.notices.push_back(
            text(unused, " of ", num_cameras, " cameras have f = 0: they were not reconstructed"));
    result.details = std::move(details);
    return result;
}

void write_bundler(const Reconstruction& reconstruction, const std::string& path) {
    const bool is_snavely = has_snavely_cameras_only(reconstruction.problem);
    const Problem converted = is_snavely ? Problem() : with_snavely_cameras(reconstruction.problem);
    const Problem& problem = is_snavely ? reconstruction.problem : converted;
    const BundlerDetails details = details_of(reconstruction, problem);
    TextOutput output(path);
    std::optional<TextOutput> list;
    if (!details.list.empty()) list.emplace(own_list_path(path));
    output.put("# Bundle file v0.3\n");
    output.put(static_cast<int64_t>(details.cameras.size()));
    output.put(" ");
    output.put(int64_t{problem.num_points()});
    output.put("\n");
    std::vector<int32_t> camera_of_image(problem.images.size());
    for (size_t c = 0; c < details.cameras.size(); ++c) {
        put_camera(output, details.cameras[c]);
        if (details.image_of_camera[c] >= 0)
            camera_of_image[details.image_of_camera[c]] = static_cast<int32_t>(c);
    }
    put_points(output, reconstruction, problem, camera_of_image);
    for (const std::string& line : details.list) {
        list->put(line);
        list->put("\n");
    }
    if (list) list->commit();
    output.commit();
}

}  // namespace clba
