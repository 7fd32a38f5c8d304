// SPDX-License-Identifier: Apache-2.0
// Bundler, NVM, OpenMVG and OpenSfM files. Those of the folder CLBA_TEST_DATA are real; their tests
// are skipped where it is not there.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <sstream>

#include "device_rig.hpp"
#include "fuzz/parsers.hpp"
#include "io/bundler.hpp"
#include "io/colmap.hpp"
#include "io/nvm.hpp"
#include "io/openmvg.hpp"
#include "io/opensfm.hpp"
#include "optimizer/solve.hpp"
#include "reference/bundle.hpp"
#include "temporary_folder.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

using test::content_of;
using test::TemporaryFolder;
using test::throws;

struct SfmFormat {
    const char* name;
    const char* file;  // "": a folder
    Reconstruction (*read)(const std::string& path);
    void (*write)(const Reconstruction& reconstruction, const std::string& path);
};
void PrintTo(const SfmFormat& format, std::ostream* stream) {
    *stream << format.name;
}
const SfmFormat bundler{"bundler", "bundle.out", read_bundler, write_bundler};
const SfmFormat nvm{"nvm", "model.nvm", read_nvm, write_nvm};
const SfmFormat openmvg{"openmvg", "sfm_data.json", read_openmvg, write_openmvg};
const SfmFormat opensfm{"opensfm", "opensfm", read_opensfm, write_opensfm};

double cost_of(const Problem& problem) {
    return reference::residual(problem, nullptr).cost;
}

std::vector<double> errors_of(const Problem& problem) {
    std::vector<double> residuals(2 * problem.observations.size()), errors;
    reference::residual(problem, residuals.data());
    for (size_t i = 0; i < residuals.size(); i += 2)
        errors.push_back(std::hypot(residuals[i], residuals[i + 1]));
    std::sort(errors.begin(), errors.end());
    return errors;
}

Reconstruction written_and_read(const SfmFormat& format, const Reconstruction& reconstruction,
                                const TemporaryFolder& folder) {
    format.write(reconstruction, folder.path(format.file));
    return format.read(folder.path(format.file));
}

// ---- Every format -------------------------------------------------------------------------------

class SfmFormats : public testing::TestWithParam<SfmFormat> {
protected:
    TemporaryFolder folder;
};
INSTANTIATE_TEST_SUITE_P(All, SfmFormats, testing::Values(bundler, nvm, openmvg, opensfm),
                         [](const auto& each) { return std::string(each.param.name); });

TEST_P(SfmFormats, HoldAProblemOfAnyOrigin) {
    for (const int32_t model : {camera_snavely, camera_simple_pinhole, camera_simple_radial}) {
        SCOPED_TRACE(camera_models[model].name);
        Reconstruction made;
        made.problem = test::small_scene(5, 40, {model}, false, 7);
        if (model == camera_snavely && std::string(GetParam().name) == "nvm")
            for (Camera& camera : made.problem.cameras) camera.params[2] = 0;
        for (int32_t c = 0; c < made.problem.num_cameras(); ++c) {
            made.cameras.push_back({static_cast<uint64_t>(c), 1000, 800});
            made.images.push_back({static_cast<uint64_t>(c), text("a b", c, ".jpg")});
        }
        const Reconstruction read = written_and_read(GetParam(), made, folder);
        read.problem.validate();
        EXPECT_EQ(read.problem.num_images(), 5);
        EXPECT_EQ(read.problem.points, made.problem.points);
        ASSERT_EQ(read.images.size(), 5u);
        for (int i = 0; i < 5; ++i) EXPECT_EQ(read.images[i].name, text("a b", i, ".jpg"));
        EXPECT_NEAR(cost_of(read.problem), cost_of(made.problem), 1e-9 * cost_of(made.problem));
    }
}

TEST_P(SfmFormats, SeedsAreReadAndWrittenWithoutAChange) {
    for (const std::string& seed : test::parser_named(GetParam().name).seeds())
        EXPECT_TRUE(test::accepts(test::parser_named(GetParam().name), seed)) << seed;
}

TEST_P(SfmFormats, AFailedWriteLeavesWhatWasThere) {
    Reconstruction made;
    made.problem = test::small_scene(3, 10, {camera_opencv}, false, 7);
    for (Camera& camera : made.problem.cameras) camera.params[0] = 2 * camera.params[1];
    if (std::string(GetParam().name) == "opensfm") {
        std::filesystem::create_directory(folder.path("opensfm"));
        const std::string path = folder.path("opensfm/reconstruction.json");
        folder.file("opensfm/reconstruction.json", "before");
        EXPECT_TRUE(throws([&] { write_opensfm(made, folder.path("opensfm")); },
                           Status::invalid_argument, {"size in pixels", "cameras[0]"}));
        EXPECT_EQ(content_of(path), "before");
        return;
    }
    const std::string path = folder.file(GetParam().file, "before");
    EXPECT_TRUE(throws([&] { GetParam().write(made, path); }, Status::invalid_argument,
                       {"cameras[0]", "opencv"}));
    EXPECT_EQ(content_of(path), "before");
    EXPECT_EQ(folder.num_files(), 1u);
}

// ---- Conventions --------------------------------------------------------------------------------

class Files : public testing::Test {
protected:
    TemporaryFolder folder;
};

// A point where the file's own formula projects it has no residual.
TEST_F(Files, BundlerLooksAlongMinusZ) {
    const Reconstruction read =
        read_bundler(folder.file("bundle.out",
                                 "# Bundle file v0.3\n2 1\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n100 "
                                 "0.1 0.01\n0 1 0\n-1 0 0\n0 0 "
                                 "1\n0 0 0\n2 -1 -4\n1 2 3\n1 1 5 -25.8056640625 -51.611328125\n"));
    ASSERT_EQ(read.problem.num_images(), 1);  // the first was not reconstructed
    EXPECT_EQ(read.images[0].id, 1u);
    EXPECT_EQ(read.points[0].color, (std::array<uint8_t, 3>{1, 2, 3}));
    EXPECT_EQ(read.observation_features, (std::vector<int32_t>{5}));
    // P = (-1, -2, -4), so -P.x / P.z = -0.25 and -P.y / P.z = -0.5.
    EXPECT_LT(cost_of(read.problem), 1e-20);
    ASSERT_EQ(read.notices.size(), 1u);
    EXPECT_NE(read.notices[0].find("1 of 2 cameras"), std::string::npos);
}

TEST_F(Files, BundlerKeepsUnusedCamerasAndTheDigitsOfRotations) {
    const std::string content =
        "# Bundle file v0.3\n3 0\n500 0.1 0.2\n0.99969382 0.00244637 0.024625\n-0.0024406 "
        "0.99999664 "
        "-0.000204\n-0.02462542 0.000144 0.99969675\n1 2 3\n0 1 2\n3 4 5\n6 7 8\n9 10 11\n12 13 "
        "14\n600 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 0\n";
    const std::string path = folder.file("bundle.out", content);
    write_bundler(read_bundler(path), folder.path("again.out"));
    EXPECT_EQ(content_of(folder.path("again.out")), content);
}

TEST_F(Files, BundlerNamesComeFromAListBesideIt) {
    const std::string content = test::parser_named("bundler").seeds()[0];
    const std::string path = folder.file("bundle.out", content);
    EXPECT_EQ(read_bundler(path).images[0].name, "");
    folder.file("list.txt", "a b.jpg 0 532.5\nunused.jpg\nc.jpg 7\n");
    EXPECT_EQ(read_bundler(path).images[0].name, "a b.jpg");
    EXPECT_EQ(read_bundler(path).images[1].name, "c.jpg 7");
    folder.file("list.txt", "a.jpg\n");
    EXPECT_TRUE(throws([&] { read_bundler(path); }, Status::format,
                       {"list.txt", "names 1 images", "3 cameras"}));
}

TEST_F(Files, BundlerErrorsTellWhereAndWhy) {
    const std::string head = "# Bundle file v0.3\n1 1\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n";
    const auto rejects = [&](const std::string& content, std::initializer_list<std::string> parts) {
        const std::string path = folder.file("bundle.out", content);
        return throws([&] { read_bundler(path); }, Status::format, parts);
    };
    EXPECT_TRUE(rejects("", {"is empty", "# Bundle file v0.3"}));
    EXPECT_TRUE(rejects("# Bundle file v0.4\n0 0\n", {":1:", "v0.4", "v0.3"}));
    EXPECT_TRUE(rejects(head + "1 2 3\n1 2 3\n1 0 0 0 0\n", {":10:", "camera 0", "f = 0"}));
    EXPECT_TRUE(rejects(head + "1 2 3\n1 2 256\n0\n", {":9:", "blue", "256", "0 to 255"}));
    EXPECT_TRUE(rejects(head + "1 2 3\n1 2 3\n1 1 0 0 0\n", {":10:", "camera index 1"}));
    EXPECT_TRUE(rejects(head + "1 2 3\n1 2 3\n999999999 ", {"ends at line 10", "camera index"}));
    EXPECT_TRUE(rejects("# Bundle file v0.3\n1 0\n1 0 0\n1 0 0\n0 1 0\n0 0 -1\n0 0 0\n",
                        {":7:", "camera 0", "no rotation"}));
}

TEST_F(Files, NvmHasCentresAndLooksAlongZ) {
    // Half a turn about x: P = (X - C) with y and z negated = (1, -2, -4 + 8) = (1, -2, 4).
    const Reconstruction read = read_nvm(folder.file(
        "a.nvm",
        "NVM_V3\n\n1\na\"b.jpg 100 0 2 0 0 1 2 3 0 0\n\n1\n2 4 -1 1 2 3 1 0 5 25 -50\n\n0\n"));
    ASSERT_EQ(read.problem.num_images(), 1);
    EXPECT_EQ(read.images[0].name, "a b.jpg");
    EXPECT_EQ(read.problem.cameras[0].model, camera_simple_pinhole);
    EXPECT_LT(cost_of(read.problem), 1e-20);
    EXPECT_TRUE(read.notices.empty());
}

TEST_F(Files, NvmDistortionOfMeasurementsBecomesTheClosestSimpleRadial) {
    const double f = 1000, r = -0.05;
    std::string points = "20\n";
    for (int i = 0; i < 20; ++i) {
        const double d = 0.025 * (i + 1), u = d * (1 + r * d * d);  // exact by VisualSFM's formula
        std::ostringstream line;
        line.precision(17);
        line << u << " 0 1 0 0 0 1 0 " << i << " " << f * d << " 0\n";
        points += line.str();
    }
    const std::string path =
        folder.file("a.nvm", text("NVM_V3\n1\na ", f, " 1 0 0 0 0 0 0 ", r, " 0\n", points, "0\n"));
    const Reconstruction read = read_nvm(path);
    EXPECT_EQ(read.problem.cameras[0].model, camera_simple_radial);
    const double worst = errors_of(read.problem).back();
    EXPECT_LT(worst, 0.1);
    EXPECT_GT(worst, 1e-4);  // it is not exact
    ASSERT_EQ(read.notices.size(), 1u);
    double told = 0;
    EXPECT_EQ(std::sscanf(read.notices[0].substr(read.notices[0].find("at most")).c_str(),
                          "at most %lf pixels", &told),
              1);
    EXPECT_NEAR(told, worst, 0.1 * worst);

    Reconstruction moved = read;
    moved.problem.cameras[0].params[3] = 0.06;
    const Reconstruction again = written_and_read(nvm, moved, folder);
    EXPECT_NEAR(again.problem.cameras[0].params[3], 0.06, 1e-14);
    moved.problem.cameras[0].params[3] = 2;
    EXPECT_TRUE(throws([&] { write_nvm(moved, folder.path("b.nvm")); }, Status::invalid_argument,
                       {"cameras[0]", "k1 = 2", "pixels"}));
}

TEST_F(Files, NvmHoldsAFixedCalibrationConstantAndKeepsOtherModels) {
    const Reconstruction read = read_nvm(
        folder.file("a.nvm",
                    "NVM_V3 FixedK 100 320 100 240\n1\na 100 1 0 0 0 0 0 0 0 0\n1\n0 0 1 0 0 0 "
                    "1 0 0 0 0\n1\nb 1 1 0 0 0 0 0 0 0 0\n0\n0\n1 0\n"));
    EXPECT_EQ(read.problem.constant_cameras, (std::vector<uint32_t>{0b111}));
    ASSERT_EQ(read.notices.size(), 1u);
    write_nvm(read, folder.path("b.nvm"));
    const std::string content = content_of(folder.path("b.nvm"));
    EXPECT_EQ(content.find("NVM_V3 FixedK 100 320 100 240\n"), 0u);
    EXPECT_NE(content.find("1\nb 1 1 0 0 0 0 0 0 0 0\n0\n0\n1 0\n"), std::string::npos);
}

TEST_F(Files, NvmErrorsTellWhereAndWhy) {
    const auto rejects = [&](const std::string& content, std::initializer_list<std::string> parts) {
        const std::string path = folder.file("a.nvm", content);
        return throws([&] { read_nvm(path); }, Status::format, parts);
    };
    EXPECT_TRUE(rejects("NVM_V4\n0\n", {":1:", "NVM_V4", "NVM_V3"}));
    EXPECT_TRUE(rejects("NVM_V3\n1\na 0 1 0 0 0 0 0 0 0 0\n", {":3:", "focal length", "camera 0"}));
    EXPECT_TRUE(rejects("NVM_V3\n1\na 1 0 0 0 0 0 0 0 0 0\n", {":3:", "quaternion (0, 0, 0, 0)"}));
    EXPECT_TRUE(rejects("NVM_V3\n1\na 1 1 0 0 0 0 0 0 0 0\n1\n0 0 1 0 0 0 1 1 0 0 0\n",
                        {":5:", "image index 1", "number of cameras = 1"}));
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
    const size_t position = text.find(from);
    EXPECT_NE(position, std::string::npos) << from;
    return text.replace(position, from.size(), to);
}

TEST_F(Files, OpenMvgKeepsWhatIsNotSolved) {
    const std::string seed = test::parser_named("openmvg").seeds()[0];
    const Reconstruction read = read_openmvg(folder.file("a.json", seed));
    ASSERT_EQ(read.problem.num_cameras(), 5);
    EXPECT_EQ(read.problem.cameras[1].model, camera_brown);
    EXPECT_EQ(read.problem.constant_cameras[1], 0b11000000u);
    EXPECT_EQ(read.problem.constant_cameras[3], 0u);
    ASSERT_EQ(read.problem.num_images(), 2);  // the third view has no pose
    EXPECT_EQ(read.images[1].id, 5u);
    EXPECT_EQ(read.images[1].name, "a/5.jpg");
    EXPECT_EQ(camera_center(read.problem.images[1].pose), (Point{-1, 0.5, 3e2}));
    write_openmvg(read, folder.path("b.json"));
    const std::string content = content_of(folder.path("b.json"));
    EXPECT_NE(content.find("\"unknown\": [\n        null,\n        true,"), std::string::npos);
    EXPECT_NE(content.find("\"id_pose\": 4294967295"), std::string::npos);
    EXPECT_NE(content.find("\"id_feat\": 4294967295"), std::string::npos);
    const size_t control = content.find("\"control_points\"");
    EXPECT_NE(content.find("\"id_feat\": 17", control), std::string::npos);
    // Cereal's numbers of types and objects.
    for (const char* number :
         {"2147483649,\n                \"polymorphic_name\": \"pinhole\"",
          "2147483650,\n                \"polymorphic_name\": \"pinhole_radial_k3\"",
          "\"polymorphic_id\": 2,", "\"id\": 2147483656"})
        EXPECT_NE(content.find(number), std::string::npos) << number;
}

TEST_F(Files, OpenMvgIntrinsicsChangeTheirTypeOnlyIfTheyMust) {
    const std::string seed = test::parser_named("openmvg").seeds()[0];
    Reconstruction read = read_openmvg(folder.file("a.json", seed));
    read.problem.cameras[0].params[0] = 600;
    read.problem.cameras[1].params[6] = 0.5;  // p1 has no place in pinhole_radial_k3
    const Reconstruction again = written_and_read(openmvg, read, folder);
    for (int c = 0; c < 5; ++c)
        EXPECT_EQ(again.problem.cameras[c].params, read.problem.cameras[c].params);
    EXPECT_EQ(again.problem.cameras[0].model, camera_simple_pinhole);
    EXPECT_EQ(again.problem.constant_cameras[1], 0u);
}

TEST_F(Files, OpenMvgErrorsTellWhereAndWhy) {
    const std::string seed = test::parser_named("openmvg").seeds()[0];
    const auto rejects = [&](const std::string& content, std::initializer_list<std::string> parts) {
        const std::string path = folder.file("a.json", content);
        return throws([&] { read_openmvg(path); }, Status::format, parts);
    };
    EXPECT_TRUE(rejects("{\"a\": ", {"a.json", "is not JSON", "line 1"}));
    EXPECT_TRUE(rejects("{}", {"the document", "sfm_data_version"}));
    EXPECT_TRUE(rejects(std::string(100, '['), {"64"}));
    EXPECT_TRUE(rejects(replaced(seed, "\"pinhole\"", "\"spherical\""),
                        {"intrinsics[0].value", "spherical", "pinhole_radial_k3"}));
    EXPECT_TRUE(rejects(replaced(seed, "[0.1, -0.2, 0.03]", "[0.1, -0.2]"),
                        {"intrinsics[1].value.ptr_wrapper.data.disto_k3", "2 entries", "3"}));
    EXPECT_TRUE(rejects(replaced(seed, "\"x\": [1.5, 2]", "\"x\": [1.5, \"2\"]"),
                        {"structure[0].value.observations[0].value.x[1]", "a number"}));
    EXPECT_TRUE(rejects(replaced(seed, "\"x\": [1.5, 2]", "\"x\": [1.5, 1e999]"), {"is not JSON"}));
    EXPECT_TRUE(rejects(replaced(seed, "[0, 0.8, 0.6]", "[0, 0.8, 0.7]"),
                        {"extrinsics[0].value.rotation", "no rotation"}));
    EXPECT_TRUE(rejects(replaced(seed, "\"id_pose\": 5", "\"id_pose\": 4294967295"),
                        {"structure[0].value.observations[1]", "view 5", "no pose"}));
    EXPECT_TRUE(
        rejects(replaced(seed, "\"id_pose\": 5", "\"id_pose\": 7"), {"views[1]", "id_pose 7"}));
}

TEST_F(Files, OpenSfmCoordinatesAreSharesOfTheLargerSide) {
    std::filesystem::create_directory(folder.path("o"));
    folder.file(
        "o/reconstruction.json",
        R"([{"cameras": {"c": {"projection_type": "perspective", "width": 200, "height": 100,
                "focal": 0.5, "k1": 0.1, "k2": 0.01}}, "shots": {"s": {"rotation": [0, 0, 0],
                "translation": [0, 0, 3], "camera": "c", "gps_position": [1, 2, 3]},
                "t": {"rotation": [0, 0, 0], "translation": [0, 0, 3], "camera": "c",
                "gps_position": null}}, "points": {"7": {"coordinates": [1, 2, 1],
                "color": [1, 2, 3]}}}])");
    folder.file("o/tracks.csv",
                "s\t7\t5\t0.12902832031250001\t0.258056640625\t9\t8\t7\ns\t8\t5\t0\t0\t9\t8\t7\n");
    const Reconstruction read = read_opensfm(folder.path("o"));
    ASSERT_EQ(read.problem.num_observations(), 1);
    EXPECT_LT(cost_of(read.problem), 1e-20);
    const auto& params = read.problem.cameras[0].params;
    EXPECT_EQ(params[0], 100);
    EXPECT_EQ(params[1], 100);
    EXPECT_EQ(params[2], 50);
    EXPECT_EQ(read.problem.constant_cameras[0], 0b110u);
    EXPECT_EQ(read.points[0].id, 7u);
    ASSERT_EQ(read.notices.size(), 2u);
    EXPECT_NE(read.notices[0].find("GPS positions of 1 shots"), std::string::npos);
    EXPECT_NE(read.notices[1].find("1 of 2 features"), std::string::npos);
}

TEST_F(Files, OpenSfmRigInstancesFollowTheirShots) {
    const std::string seed = test::parser_named("opensfm").seeds()[0];
    std::filesystem::create_directory(folder.path("o"));
    const size_t first = seed.find(test::separator);
    const size_t second = seed.find(test::separator, first + 1);
    folder.file("o/reconstruction.json", seed.substr(0, first));
    folder.file("o/tracks.csv", seed.substr(first + test::separator.size(),
                                            second - first - test::separator.size()));
    folder.file("o/ground_control_points.json", "{\"points\": []}");
    Reconstruction read = read_opensfm(folder.path("o"));
    ASSERT_EQ(read.notices.size(), 3u);
    EXPECT_NE(read.notices[0].find("ground_control_points.json"), std::string::npos);
    read.problem.images[0].pose.translation = {7.125, 8.25, 9.5};
    write_opensfm(read, folder.path("p"));
    const std::string content = content_of(folder.path("p/reconstruction.json"));
    const size_t instance = content.find("\"rig_instances\"");
    EXPECT_NE(content.find("7.125,", instance), std::string::npos);
    EXPECT_EQ(content_of(folder.path("p/ground_control_points.json")), "{\"points\": []}");
    EXPECT_EQ(content_of(folder.path("p/tracks.csv")), content_of(folder.path("o/tracks.csv")));
    // Observations that are others than those that were read get tracks of their own.
    std::swap(read.problem.observations[0].point, read.problem.observations[2].point);
    const Reconstruction other = written_and_read(opensfm, read, folder);
    EXPECT_EQ(other.problem.num_observations(), read.problem.num_observations());
    EXPECT_NEAR(cost_of(other.problem), cost_of(read.problem), 1e-9 * cost_of(read.problem));
}

TEST_F(Files, OpenSfmErrorsTellWhereAndWhy) {
    const std::string seed = test::parser_named("opensfm").seeds()[0];
    std::filesystem::create_directory(folder.path("o"));
    const size_t first = seed.find(test::separator);
    const std::string whole = seed.substr(0, first);
    const auto rejects = [&](const std::string& json, const std::string& tracks,
                             std::initializer_list<std::string> parts) {
        folder.file("o/reconstruction.json", json);
        folder.file("o/tracks.csv", tracks);
        return throws([&] { read_opensfm(folder.path("o")); }, Status::format, parts);
    };
    EXPECT_TRUE(rejects("[]", "", {"reconstruction.json", "no reconstruction"}));
    EXPECT_TRUE(rejects(replaced(whole, "\"perspective\"", "\"spherical\""), "",
                        {"[0].cameras.a", "projection_type 'spherical'", "perspective"}));
    EXPECT_TRUE(rejects(replaced(whole, "\"camera\": \"a\"", "\"camera\": \"z\""), "",
                        {"[0].shots.1.jpg.camera", "'z'"}));
    EXPECT_TRUE(rejects(replaced(whole, "\"1.jpg\": \"r\"", "\"1.jpg\": \"r\", \"2 3.jpg\": \"r\""),
                        "", {"[0].rig_instances.0.rig_camera_ids", "2 shots", "rigs"}));
    EXPECT_TRUE(rejects(whole, "OPENSFM_TRACKS_VERSION_v3\n", {"tracks.csv:1:", "3", "v2"}));
    EXPECT_TRUE(
        rejects(whole, "1.jpg\t7\t1\t0.5\t0.5\t1\t2\n", {"tracks.csv:1:", "7 columns", "8"}));
    EXPECT_TRUE(
        rejects(whole, "1.jpg\t7\t1\t0.5\tnan\t1\t2\t3\n", {"tracks.csv:1:", "the y", "nan"}));
}

// ---- Real files ---------------------------------------------------------------------------------

std::string data(const std::string& name) {
    const char* folder = std::getenv("CLBA_TEST_DATA");
    return (std::filesystem::path(folder ? folder : "") / name).string();
}

struct RealFile {
    SfmFormat format;
    const char* path;
    int images, points, observations;
    double median, ninth_decile;  // of reprojection errors at the state of the file, pixels
};
void PrintTo(const RealFile& file, std::ostream* stream) {
    *stream << file.path;
}

class RealFiles : public testing::TestWithParam<RealFile> {
protected:
    TemporaryFolder folder;
};
INSTANTIATE_TEST_SUITE_P(
    DataIndex, RealFiles,
    testing::Values(RealFile{bundler, "bundler/kermit/bundle.out", 9, 634, 0, 1, 2},
                    RealFile{bundler, "bundler/balbianello/Balbianello.out", 5, 544, 0, 1, 2},
                    RealFile{openmvg, "openmvg/maupertuis/sfm_data.json", 4, 365, 0, 1, 2},
                    RealFile{opensfm, "opensfm/berlin/reconstruction_example.json", 3, 1430, 0, 2,
                             8}));

TEST_P(RealFiles, AreReadAsTheirProgramsMeanThem) {
    const RealFile& file = GetParam();
    if (!std::filesystem::exists(data(file.path)))
        GTEST_SKIP() << "no file " << data(file.path) << "; set CLBA_TEST_DATA";
    const Reconstruction read = file.format.read(data(file.path));
    read.problem.validate();
    EXPECT_EQ(read.problem.num_images(), file.images);
    EXPECT_EQ(read.problem.num_points(), file.points);
    const std::vector<double> errors = errors_of(read.problem);
    const double median = errors[errors.size() / 2], decile = errors[errors.size() * 9 / 10];
    std::printf(
        "%zu observations, reprojection errors: median %.3f, 90%% %.3f, largest %.3f; cost %.6f\n",
        errors.size(), median, decile, errors.back(), cost_of(read.problem));
    EXPECT_LT(median, file.median);
    EXPECT_LT(decile, file.ninth_decile);
    EXPECT_EQ(reference::residual(read.problem, nullptr).num_behind, 0);

    const Reconstruction again = written_and_read(file.format, read, folder);
    EXPECT_EQ(cost_of(again.problem), cost_of(read.problem));
    EXPECT_EQ(again.problem.points, read.problem.points);
    TemporaryFolder other;
    file.format.write(again, other.path(file.format.file));
    const bool is_folder = std::filesystem::is_directory(folder.path(file.format.file));
    for (const char* name : {"", "/reconstruction.json", "/tracks.csv"}) {
        if (is_folder == (*name != 0)) {
            EXPECT_EQ(content_of(other.path(file.format.file) + name),
                      content_of(folder.path(file.format.file) + name));
        }
    }
}

TEST_P(RealFiles, SolvedAndWrittenHaveTheCostOfTheSolve) {
    const RealFile& file = GetParam();
    if (!std::filesystem::exists(data(file.path)))
        GTEST_SKIP() << "no file " << data(file.path) << "; set CLBA_TEST_DATA";
    Reconstruction solved = file.format.read(data(file.path));
    const double start = cost_of(solved.problem);
    std::unique_ptr<DeviceProblem> device;
    const Summary summary =
        solve(solved.problem, test::test_context(), {}, Precision::mixed, device);
    const double cost = cost_of(solved.problem);
    EXPECT_LT(cost, start) << summary.message;
    const Reconstruction again = written_and_read(file.format, solved, folder);
    EXPECT_NEAR(cost_of(again.problem), cost, 1e-12 * cost);
    EXPECT_EQ(again.problem.observations.size(), solved.problem.observations.size());
    std::printf("cost %.6f -> %.6f, %.1e of it apart when read back: %s\n", start, cost,
                std::abs(cost_of(again.problem) - cost) / cost, summary.message.c_str());
}

}  // namespace
}  // namespace clba
