// SPDX-License-Identifier: Apache-2.0
#include "fuzz/seeds.hpp"

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string_view>

#include "base/error.hpp"
#include "fuzz/parsers.hpp"
#include "io/colmap.hpp"

namespace clba::test {
namespace {

// A value and what surrounds it in cereal's layout.
std::string entry(int64_t key, const std::string& value) {
    return text("{\"key\": ", key, ", \"value\": ", value, "}");
}

std::string pointer(int64_t polymorphic_id, const std::string& name, int64_t id,
                    const std::string& data) {
    return text("{\"polymorphic_id\": ", polymorphic_id,
                name.empty() ? "" : ", \"polymorphic_name\": \"" + name + "\"",
                ", \"ptr_wrapper\": {\"id\": ", id, ", \"data\": {", data, "}}}");
}

std::string view(int64_t id, int64_t id_intrinsic, int64_t id_pose) {
    return text("\"local_path\": \"a\", \"filename\": \"", id,
                ".jpg\", \"width\": 640, \"height\": 480, \"id_view\": ", id,
                ", \"id_intrinsic\": ", id_intrinsic, ", \"id_pose\": ", id_pose);
}

}  // namespace

std::vector<std::string> bal_seeds() {
    return {
        "2 1 2\n0 0 1.5 -2.25\n1 0 3e2 4\n0.1\n0.2\n-0.3\n1\n2\n3\n500\n-0.1\n0.01\n0\n0\n0\n-1\n"
        "-2\n-3\n600\n0.2\n0.02\n7\n8\n-9\n",
        "0 0 0\n", "1 1 0\n0 0 0 0 0 0 1 0 0\n1 2 3\n"};
}

std::vector<std::string> bundler_seeds() {
    const std::string head =
        "# Bundle file v0.3\n3 2\n688.4 -0.04 0.06\n1 0 0\n0 1 0\n0 0 1\n0.2 0.3 -0.5\n0 0 0\n0 0 "
        "0\n"
        "0 0 0\n0 0 0\n0 0 0\n690 0 0\n0.8 0.6 0\n-0.6 0.8 0\n0 0 1\n-1.2 1.1 -1.2\n";
    const std::string points =
        "1.5 -2 3e-1\n255 0 17\n2 0 12 -3.25 4 2 7 1.5 2.5\n0 0 0\n1 2 3\n0\n";
    return {head + points, text(head, points, separator, "a b.jpg 0 532.5\nc.jpg\nd.jpg 0 1\n"),
            "# Bundle file v0.3\n0 0\n"};
}

std::vector<std::string> nvm_seeds() {
    const std::string cameras =
        "\n\n2\na\"b.jpg\t500 1 0 0 0 0.5 -0.25 2 0 0\nc.jpg\t600 0.5 0.5 -0.5 0.5 1 2 3 -0.05 "
        "0\n\n";
    const std::string points = "2\n1 2 3 255 0 7 2 0 5 100.5 -20 1 6 -200 150 \n4 5 6 0 0 0 0\n";
    return {"NVM_V3" + cameras + points + "\n0\n",
            "NVM_V3 FixedK 500 320 500 240" + cameras + points + "\n\n\n0\n#comment\n1 0\n",
            "NVM_V3" + cameras + points + "1\nd.jpg 1 1 0 0 0 0 0 0 0 0\n0\n0\n", "NVM_V3\n0\n"};
}

std::vector<std::string> openmvg_seeds() {
    const std::string intrinsics = text(
        "\"intrinsics\": [",
        entry(0, pointer(2147483649, "pinhole", 2147483651,
                         "\"width\": 640, \"height\": 480, \"focal_length\": 500.5, "
                         "\"principal_point\": [320, 240.5]")),
        ", ",
        entry(1, pointer(2147483650, "pinhole_radial_k3", 2147483652,
                         "\"width\": 640, \"height\": 480, \"focal_length\": 500.5, "
                         "\"principal_point\": [320, 240.5], \"disto_k3\": [0.1, -0.2, 0.03]")),
        ", ",
        entry(2, pointer(2, "", 2147483653,
                         "\"width\": 640, \"height\": 480, \"focal_length\": 500.5, "
                         "\"principal_point\": [320, 240.5], \"disto_k3\": [0, 0, 0]")),
        ", ",
        entry(3, pointer(2147483651, "pinhole_brown_t2", 2147483654,
                         "\"width\": 640, \"height\": 480, \"focal_length\": 500.5, "
                         "\"principal_point\": [320, 240.5], \"disto_t2\": [0.1, 0, 0, 0.01, 0]")),
        ", ",
        entry(4, pointer(2147483652, "pinhole_radial_k1", 2147483655,
                         "\"width\": 640, \"height\": 480, \"focal_length\": 500.5, "
                         "\"principal_point\": [320, 240.5], \"disto_k1\": [0.1]")),
        "]");
    const std::string views =
        text("\"views\": [", entry(0, pointer(1073741824, "", 2147483649, view(0, 0, 7))), ", ",
             entry(5, pointer(1073741824, "", 2147483650, view(5, 1, 5))), ", ",
             entry(6, pointer(1073741824, "", 2147483651, view(6, 1, 4294967295))), "]");
    const std::string extrinsics =
        "\"extrinsics\": [" +
        entry(7,
              "{\"rotation\": [[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]], \"center\": [1, 2, 3]}") +
        ", " +
        entry(5, "{\"rotation\": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], \"center\": [-1, 0.5, 3e2]}") +
        "]";
    const std::string point =
        entry(3, "{\"X\": [0.25, -1, 9], \"observations\": [" +
                     entry(0, "{\"id_feat\": 17, \"x\": [1.5, 2]}") + ", " +
                     entry(5, "{\"id_feat\": 4294967295, \"x\": [100.25, -2]}") + "]}");
    const std::string start = "{\"sfm_data_version\": \"0.3\", \"root_path\": \"/a\", ";
    return {text(start, views, ", ", intrinsics, ", ", extrinsics, ", \"structure\": [", point,
                 "], \"control_points\": [", point, "], \"unknown\": [null, true, \"\\u00e9\"]}"),
            start +
                "\"views\": [], \"intrinsics\": [], \"extrinsics\": [], \"structure\": [], "
                "\"control_points\": []}"};
}

std::vector<std::string> opensfm_seeds() {
    const std::string cameras =
        R"("cameras": {"a": {"projection_type": "perspective", "width": 3264, "height": 2448,
        "focal": 0.87, "k1": 0.0885, "k2": -0.23}, "b": {"projection_type": "radial", "width": 640,
        "height": 480, "focal_x": 0.9, "focal_y": 0.91, "c_x": 0.01, "c_y": -0.02, "k1": 0.1,
        "k2": 0.01}, "c": {"width": 640, "height": 480, "focal": 1}, "d": {"projection_type":
        "simple_radial", "width": 640, "height": 480, "focal_x": 0.9, "focal_y": 0.9}})";
    const std::string shots =
        R"("shots": {"1.jpg": {"rotation": [1.0, -0.3, 0.5], "translation": [0.5, 24.75, -20],
        "camera": "a", "gps_dop": 5.0, "capture_time": 0}, "2 3.jpg": {"rotation": [0, 0, 0],
        "camera": "b"}})";
    const std::string points =
        R"("points": {"7": {"color": [36.0, 25.5, 16], "coordinates": [14.8, 16.6, 37.4]},
        "x": {"color": [0, 0, 0], "coordinates": [1, 2, 3], "reprojection_errors": {}}})";
    const std::string rigs =
        R"("rig_cameras": {"r": {"rotation": [0, -0.0, 0], "translation": [0, 0, 0]}},
        "rig_instances": {"0": {"translation": [0.5, 24.75, -20], "rotation": [1.0, -0.3, 0.5],
        "rig_camera_ids": {"1.jpg": "r"}}}, "biases": {}, "reference_lla": {"altitude": 0.0})";
    const std::string tracks2 =
        "OPENSFM_TRACKS_VERSION_v2\n1.jpg\t7\t2594\t0.0379803\t-0.0481853\t0."
        "00155505\t155\t145\t143\t"
        "-1\t-1\n2 3.jpg\t7\t1\t0.1\t0.2\t0.004\t0\t0\t0\t3\t4\n2 "
        "3.jpg\tx\t2\t-0.1\t0.3\t0.004\t0\t"
        "0\t0\t-1\t-1\n9.jpg\t8\t1\t0.1\t0.2\t0.004\t0\t0\t0\t-1\t-1\n";
    const std::string tracks0 = "1.jpg\t7\t2594\t0.0379803\t-0.0481853\t155\t145\t143\n";
    const std::string tracks1 =
        "OPENSFM_TRACKS_VERSION_v1\n1.jpg\t7\t2594\t0.0379803\t-0.0481853\t0.5\t155\t145\t143\n";
    const std::string whole =
        text("[{", cameras, ", ", shots, ", ", points, ", ", rigs, "}, {\"cameras\": {}}]");
    return {text(whole, separator, tracks2, separator, "{\"points\": []}"),
            text(whole, separator, tracks0), text(whole, separator, tracks1),
            text("[{\"cameras\": {}, \"shots\": {}}]", separator)};
}

std::vector<std::string> colmap_text_seeds() {
    const std::string cameras =
        "# comment\n1 SIMPLE_RADIAL 640 480 500.5 320 240 0.01\n7 PINHOLE 320 240 300 301 160 120\n"
        "9 OPENCV 640 480 500 501 320 240 0.1 0.01 0.001 0.002\n";
    const std::string images =
        "1 0.5 0.5 -0.5 0.5 1 2 3 1 a.jpg\n10.5 20.25 3 30 40 -1 50 60 4\n2 1 0 0 0 -1 -2 -3 7 "
        "b.jpg\n"
        "11.5 21.25 3\n5 1 0 0 0 0 0 0 9 c.jpg\n\n";
    const std::string points = "3 0.5 0.25 7 255 0 17 0.5 1 0 2 0\n4 1 2 3 0 0 0 -1 1 2\n";
    const std::string rigs = "1 1 CAMERA 1\n2 1 CAMERA 7\n3 1 CAMERA 9\n";
    const std::string frames =
        "1 1 0.5 0.5 -0.5 0.5 1 2 3 1 CAMERA 1 1\n2 2 1 0 0 0 -1 -2 -3 1 CAMERA 7 2\n"
        "3 3 1 0 0 0 0 0 0 1 CAMERA 9 5\n";
    return {
        text(cameras, separator, images, separator, points),
        text(cameras, separator, images, separator, points, separator, rigs, separator, frames),
        text(
            cameras, separator, images, separator, points, separator,
            "1 3 CAMERA 1 CAMERA 7 1 0.5 0.5 0.5 0.5 0 0.25 1 IMU 1 0\n3 1 CAMERA 9\n", separator,
            "1 1 0.5 0.5 -0.5 0.5 1 2 3 2 CAMERA 1 1 CAMERA 7 2\n3 3 1 0 0 0 0 0 0 1 CAMERA 9 5\n"),
        text("", separator, "", separator, "")};
}

std::vector<std::string> colmap_binary_seeds() {
    namespace fs = std::filesystem;
    const fs::path folder = fs::temp_directory_path() / text("clba_seeds_", ::getpid());
    std::vector<std::string> seeds;
    for (const std::string& seed : colmap_text_seeds()) {
        fs::create_directories(folder / "text");
        std::string_view rest = seed;
        for (const char* name : {"cameras", "images", "points3D", "rigs", "frames"}) {
            const size_t end = rest.find(separator);
            std::ofstream(folder / "text" / text(name, ".txt"), std::ios::binary)
                << rest.substr(0, end);
            if (end == std::string_view::npos) break;
            rest.remove_prefix(end + separator.size());
        }
        write_colmap_binary(read_colmap_text((folder / "text").string()),
                            (folder / "binary").string());
        std::string joined;
        for (const char* name : {"cameras", "images", "points3D", "rigs", "frames"}) {
            std::ifstream file(folder / "binary" / text(name, ".bin"), std::ios::binary);
            if (!file) break;
            if (!joined.empty()) joined += separator;
            joined.append(std::istreambuf_iterator<char>(file), {});
        }
        seeds.push_back(std::move(joined));
        fs::remove_all(folder);
    }
    return seeds;
}

}  // namespace clba::test
