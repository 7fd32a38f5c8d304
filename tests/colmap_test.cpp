// SPDX-License-Identifier: Apache-2.0
#include "io/colmap.hpp"
#include "io/colmap_frames.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <set>

#include "io/convert.hpp"
#include "io/formats.hpp"
#include "io/read_progress.hpp"
#include "reference/bundle.hpp"
#include "temporary_folder.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

using test::content_of;
using test::TemporaryFolder;
using test::throws;

using Files = std::map<std::string, std::string>;

// Two cameras, of which one is shared; image 9 has features that no point claims, image 4 sees
// point 70 twice, image 2 has no features; the ids are in no order.
const Files small_model{
    {"cameras.txt",
     "# Camera list with one line of data per camera:\n"
     "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
     "# Number of cameras: 2\n"
     "5 SIMPLE_RADIAL 640 480 500 320 240 0.125\n"
     "3 PINHOLE 800 600 700 710 400 300\n"},
    {"images.txt",
     "# Image list with two lines of data per image:\n"
     "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
     "#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
     "# Number of images: 3, mean observations per image: 1.6666666666666667\n"
     "9 1 0 0 0 0.5 0 5 5 a name.jpg\n"
     "1.5 2.5 -1 300 200 70 10 20 18446744073709551614 3.5 4.5 -1 \n"
     "2 0.5 0.5 0.5 0.5 0 0 1 3 empty.jpg\n"
     "\n"
     "4 0 1 0 0 0 0 -5 5 c.jpg\n"
     "301 201 70 302 202 70 11 21 18446744073709551614 \n"},
    {"points3D.txt",
     "# 3D point list with one line of data per point:\n"
     "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
     "# Number of points: 3, mean track length: 1.6666666666666667\n"
     "18446744073709551614 1 2 3 10 20 30 0.75 4 2 9 2\n"
     "70 -1 0.25 0.10000000000000001 255 0 1 1.5 9 1 4 1 4 0\n"
     "6 0 0 0 1 2 3 0 \n"},
};

const Files frame_files{
    {"rigs.txt",
     "# Rig calib list with one line of data per calib:\n"
     "#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, "
     "SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n"
     "# Number of rigs: 2\n"
     "8 3 CAMERA 5 CAMERA 3 1 0 0 1 0 0 0 2 IMU 1 0\n"
     "1 1 CAMERA 5\n"},
    {"frames.txt",
     "# Frame list with one line of data per frame:\n"
     "#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, DATA_IDS[] "
     "as (SENSOR_TYPE, SENSOR_ID, DATA_ID)\n"
     "# Number of frames: 2\n"
     "30 8 1 0 0 0 0.5 0 5 2 CAMERA 5 9 CAMERA 3 2\n"
     "31 1 0 1 0 0 0 0 -5 1 CAMERA 5 4\n"},
};

class ColmapTest : public testing::Test {
protected:
    std::string put(const std::string& name, const Files& files) const {
        std::filesystem::create_directories(folder.path(name));
        for (const auto& [file, content] : files) folder.file(name + "/" + file, content);
        return folder.path(name);
    }
    static Files get(const std::string& path) {
        Files files;
        for (const auto& entry : std::filesystem::directory_iterator(path))
            files[entry.path().filename().string()] = content_of(entry.path().string());
        return files;
    }
    Files binary_of(const Files& text_files) {
        write_colmap_binary(read_colmap_text(put("to binary", text_files)), folder.path("binary"));
        return get(folder.path("binary"));
    }
    static Files with_frames() {
        Files files = small_model;
        files.insert(frame_files.begin(), frame_files.end());
        return files;
    }
    // The model with one text replaced is refused with these parts in the message.
    testing::AssertionResult rejects(const Files& files, const std::string& file,
                                     const std::string& from, const std::string& to,
                                     std::initializer_list<std::string> parts) const {
        Files changed = files;
        const size_t position = changed[file].find(from);
        EXPECT_NE(position, std::string::npos) << from;
        changed[file].replace(position, from.size(), to);
        const std::string path = put("changed", changed);
        return throws([&] { read_colmap_text(path); }, Status::format, parts);
    }

    TemporaryFolder folder;
};

TEST_F(ColmapTest, RowsAreThoseOfTheFile) {
    const Reconstruction r = read_colmap_text(put("model", small_model));
    const Problem& p = r.problem;
    ASSERT_EQ(p.num_cameras(), 2);
    EXPECT_EQ(p.cameras[0].model, camera_simple_radial);
    EXPECT_EQ(p.cameras[0].params[3], 0.125);
    EXPECT_EQ(p.cameras[1].model, camera_pinhole);
    EXPECT_EQ(r.cameras[1].id, 3u);
    EXPECT_EQ(r.cameras[1].width, 800u);
    EXPECT_EQ(r.cameras[1].height, 600u);
    ASSERT_EQ(p.num_images(), 3);
    EXPECT_EQ(p.images[0].camera, 0);
    EXPECT_EQ(p.images[1].camera, 1);
    EXPECT_EQ(p.images[1].pose.rotation, (std::array{0.5, 0.5, 0.5, 0.5}));
    EXPECT_EQ(p.images[2].pose.translation, (std::array{0.0, 0.0, -5.0}));
    EXPECT_EQ(r.images[0].name, "a name.jpg");
    EXPECT_EQ(r.images[2].id, 4u);
    ASSERT_EQ(p.num_points(), 3);
    EXPECT_EQ(r.points[0].id, 18446744073709551614u);
    EXPECT_EQ(r.points[1].color, (std::array<uint8_t, 3>{255, 0, 1}));
    EXPECT_EQ(r.points[1].error, 1.5);
    EXPECT_EQ(p.points[1], (Point{-1, 0.25, 0.1}));
    ASSERT_EQ(p.num_observations(), 5);
    const Observation& o = p.observations[3];
    EXPECT_TRUE(o.image == 2 && o.point == 1 && o.x == 302 && o.y == 202);
    EXPECT_EQ(r.observation_features, (std::vector<int32_t>{2, 2, 1, 1, 0}));
    ASSERT_EQ(r.unmatched.size(), 2u);
    EXPECT_TRUE(r.unmatched[1].image == 0 && r.unmatched[1].index == 3 && r.unmatched[1].y == 4.5);
    EXPECT_FALSE(r.has_frames);
    EXPECT_TRUE(r.notices.empty());
}

TEST_F(ColmapTest, TextAndBinaryComeBackToTheByte) {
    for (const Files& files : {small_model, with_frames()}) {
        const std::string model = put("model", files);
        write_colmap_text(read_colmap_text(model), folder.path("text"));
        EXPECT_EQ(get(folder.path("text")), files);
        const Files binary = binary_of(files);
        EXPECT_EQ(binary.size(), files.size());
        write_colmap_binary(read_colmap_binary(folder.path("binary")), folder.path("again"));
        EXPECT_EQ(get(folder.path("again")), binary);
        write_colmap_text(read_colmap_binary(folder.path("binary")), folder.path("text"));
        EXPECT_EQ(get(folder.path("text")), files);
    }
}

TEST_F(ColmapTest, TextOfOtherWriters) {
    Files files = small_model;
    std::string& points = files["points3D.txt"];
    points = "\r\n# no counts\r\n" + points.substr(points.find("1844"));
    for (size_t at = 0; (at = points.find('\n', at)) != std::string::npos; at += 3)
        points.replace(at, 1, " \r\n");
    files["cameras.txt"] =
        "5  SIMPLE_RADIAL\t640 480 5e2 +320 240. .125\n3 PINHOLE 800 600 700 710 "
        "400 300";
    files["images.txt"].pop_back();
    Problem expected = read_colmap_text(put("model", small_model)).problem;
    const Problem read = read_colmap_text(put("other", files)).problem;
    EXPECT_EQ(digest(read), digest(expected));
    EXPECT_EQ(read.num_observations(), expected.num_observations());
}

TEST_F(ColmapTest, QuaternionsAreNormalisedAndWrittenAsTheyWere) {
    Files files = small_model;
    std::string& images = files["images.txt"];
    images.replace(images.find("0.5 0.5 0.5 0.5"), 15, "2 2 2 2");
    Reconstruction r = read_colmap_text(put("model", files));
    EXPECT_EQ(r.problem.images[1].pose.rotation, (std::array{0.5, 0.5, 0.5, 0.5}));
    write_colmap_text(r, folder.path("same"));
    EXPECT_EQ(get(folder.path("same")), files);
    r.problem.images[0].pose.translation[0] = 0.75;
    write_colmap_text(r, folder.path("moved"));
    EXPECT_NE(content_of(folder.path("moved/images.txt")).find("9 1 0 0 0 0.75 0 5 5 a name.jpg"),
              std::string::npos);
    EXPECT_NE(content_of(folder.path("moved/images.txt")).find("2 0.5 0.5 0.5 0.5 0 0 1 3"),
              std::string::npos);
}

TEST_F(ColmapTest, ErrorsOfPointsFollowTheState) {
    Reconstruction r = read_colmap_text(put("model", small_model));
    r.problem.points[2] = {0, 0, 1};
    write_colmap_text(r, folder.path("changed"));
    const Reconstruction changed = read_colmap_text(folder.path("changed"));
    const std::vector<double> errors = reference::mean_reprojection_errors(r.problem);
    for (size_t i = 0; i < 3; ++i) EXPECT_EQ(changed.points[i].error, errors[i]);
    EXPECT_EQ(errors[2], 0);
    // Point 1 in image 0 by hand: P = (-0.5, 0.25, 5.1), f 500, k 0.125, at (300, 200).
    const double u = -0.5 / 5.1, v = 0.25 / 5.1, factor = 500 * (1 + 0.125 * (u * u + v * v));
    const double by_hand = std::hypot(factor * u + 320 - 300, factor * v + 240 - 200);
    Problem one = r.problem;
    one.observations = {r.problem.observations[2]};
    EXPECT_NEAR(reference::mean_reprojection_errors(one)[1], by_hand, 1e-12);
}

TEST_F(ColmapTest, PosesOfImagesAreThoseOfTheirFrames) {
    const Reconstruction r = read_colmap_text(put("model", with_frames()));
    ASSERT_EQ(r.rigs.size(), 2u);
    EXPECT_FALSE(r.rigs[0].sensors[2].has_pose);
    // Half a turn about y, then 2 along z: (0.5, 0, 5) -> (-0.5, 0, -5 + 2).
    const Pose& pose = r.problem.images[1].pose;
    EXPECT_EQ(pose.rotation, (std::array{0.0, 0.0, 1.0, 0.0}));
    EXPECT_EQ(pose.translation, (std::array{-0.5, 0.0, -3.0}));
    EXPECT_TRUE(r.notices.empty());
    // Camera 5 is the reference sensor of two rigs.
    const Rigs& rigs = r.problem.rigs;
    EXPECT_EQ(rigs.image_frame, (std::vector<int32_t>{0, 0, 1}));
    EXPECT_EQ(rigs.image_sensor, (std::vector<int32_t>{0, 1, 2}));
    ASSERT_EQ(rigs.sensors.size(), 3u);
    EXPECT_EQ(rigs.sensors[1].translation, (Point{0, 0, 2}));
    EXPECT_EQ(rigs.constant_sensors, (std::vector<uint8_t>{3, 0, 3}));
    EXPECT_EQ(rigs.frames[1].translation, (Point{0, 0, -5}));

    // Models whose images have all a pose to themselves have no rigs to solve.
    Files alone = with_frames();
    alone["frames.txt"].replace(alone["frames.txt"].find("2 CAMERA 5 9 CAMERA 3 2"), 23,
                                "1 CAMERA 5 9");
    alone["frames.txt"] += "32 9 1 0 0 0 0 0 1 1 CAMERA 3 2\n";
    alone["rigs.txt"] += "9 1 CAMERA 3\n";
    EXPECT_TRUE(read_colmap_text(put("alone", alone)).problem.rigs.empty());

    Files unknown = with_frames();
    unknown["rigs.txt"].replace(unknown["rigs.txt"].find("3 1 0 0 1 0 0 0 2"), 17, "3 0");
    const Reconstruction without_pose = read_colmap_text(put("unknown", unknown));
    ASSERT_EQ(without_pose.notices.size(), 1u);
    EXPECT_NE(without_pose.notices[0].find("1 images are of sensors whose pose"),
              std::string::npos);
    EXPECT_EQ(without_pose.problem.images[1].pose.translation, (Point{0, 0, 1}));
}

// A solve moves frames and sensors.
TEST_F(ColmapTest, RigsThatMovedComeBack) {
    Reconstruction r = read_colmap_text(put("model", with_frames()));
    Rigs& rigs = r.problem.rigs;
    rigs.frames[0].translation = {0.25, 1, 5};
    rigs.sensors[1].translation = {0, 0.5, 2.25};
    compose_images(rigs, r.problem.images);
    write_colmap_text(r, folder.path("moved"));
    const Reconstruction moved = read_colmap_text(folder.path("moved"));
    EXPECT_EQ(moved.rigs.size(), 2u);
    EXPECT_EQ(moved.rigs[0].sensors.size(), 3u);
    EXPECT_EQ(moved.rigs[0].sensors[1].sensor_from_rig.translation, (std::array{0.0, 0.5, 2.25}));
    EXPECT_EQ(digest(moved.problem), digest(r.problem));
}

// Rigs that no file had.
TEST_F(ColmapTest, RigsOfAProblemAreWritten) {
    Reconstruction r = read_colmap_text(put("model", small_model));
    EXPECT_FALSE(r.has_frames);
    Rigs rigs;
    rigs.image_frame = {0, 0, 1};
    rigs.image_sensor = {1, 0, 1};
    rigs.sensors = {{{1, 0, 0, 0}, {0, 0, 2}}, {}};
    rigs.frames = {{{0.6, 0.8, 0, 0}, {1, 2, 3}}, {{1, 0, 0, 0}, {0, 0, 4}}};
    rigs.constant_sensors = {0, 3};
    rigs.constant_frames = {0, 0};
    r.problem.rigs = rigs;
    compose_images(rigs, r.problem.images);
    r.problem.validate();
    write_colmap_binary(r, folder.path("rigs"));
    const Reconstruction read = read_colmap_binary(folder.path("rigs"));
    ASSERT_EQ(read.rigs.size(), 1u);
    EXPECT_EQ(read.rigs[0].sensors[0].sensor.id, 5u);  // at the origin
    ASSERT_EQ(read.frames.size(), 2u);
    EXPECT_EQ(read.frames[0].data.size(), 2u);
    for (size_t i = 0; i < r.problem.images.size(); ++i) {
        EXPECT_EQ(read.problem.images[i].pose.rotation, r.problem.images[i].pose.rotation);
        EXPECT_EQ(read.problem.images[i].pose.translation, r.problem.images[i].pose.translation);
    }
    EXPECT_TRUE(colmap::can_hold_rigs(r.problem));
    // One camera for two sensors cannot be said.
    r.problem.images[1].camera = r.problem.images[0].camera;
    EXPECT_FALSE(colmap::can_hold_rigs(r.problem));
    write_colmap_binary(r, folder.path("split"));
    EXPECT_EQ(read_colmap_binary(folder.path("split")).frames.size(), 3u);
}

TEST_F(ColmapTest, FramesFollowTheirImagesWhileTheseAgree) {
    Reconstruction r = read_colmap_text(put("model", with_frames()));
    r.problem.rigs = Rigs();  // images are free
    // The world moves along x: both images of frame 30 keep their places on the rig.
    r.problem.images[0].pose.translation[0] += 0.25;
    r.problem.images[1].pose.translation[0] -= 0.25;
    write_colmap_binary(r, folder.path("moved"));
    const Reconstruction moved = read_colmap_binary(folder.path("moved"));
    ASSERT_EQ(moved.rigs.size(), 2u);
    EXPECT_EQ(moved.rigs[0].sensors.size(), 3u);
    EXPECT_EQ(moved.frames[0].rig_from_world.translation, (std::array{0.75, 0.0, 5.0}));
    EXPECT_EQ(moved.problem.images[1].pose.translation[0], -0.75);

    r.problem.images[1].pose.translation[0] += 1e-6;
    write_colmap_binary(r, folder.path("split"));
    const Reconstruction split = read_colmap_binary(folder.path("split"));
    EXPECT_EQ(split.rigs.size(), 2u);  // one a camera
    ASSERT_EQ(split.frames.size(), 3u);
    EXPECT_EQ(split.frames[1].id, 2u);
    EXPECT_EQ(split.frames[1].rig, 3u);
    EXPECT_TRUE(split.notices.empty());
    EXPECT_EQ(digest(split.problem), digest(r.problem));

    // What an IMU took at the time of the frame has no other place.
    r.frames[0].data.push_back({{1, 1}, 77});
    EXPECT_TRUE(throws([&] { write_colmap_binary(r, folder.path("imu")); },
                       Status::invalid_argument, {"frame 30", "IMU"}));
    EXPECT_FALSE(std::filesystem::exists(folder.path("imu")));
}

TEST_F(ColmapTest, WhatIsWrongInATextIsNamed) {
    const Files& m = small_model;
    EXPECT_TRUE(rejects(m, "cameras.txt", "SIMPLE_RADIAL", "KANNALA",
                        {"cameras.txt", "camera 5", "KANNALA", "PINHOLE"}));
    EXPECT_TRUE(rejects(m, "cameras.txt", "0.125", "nan", {"cameras.txt:4", "'nan'", "finite"}));
    EXPECT_TRUE(rejects(m, "cameras.txt", " 0.125", "", {"cameras.txt:4", "parameter"}));
    EXPECT_TRUE(rejects(m, "cameras.txt", "0.125", "0.125 1", {"cameras.txt:4", "'1' follows"}));
    EXPECT_TRUE(rejects(m, "cameras.txt", "5 SIMPLE", "3 SIMPLE", {"two cameras", "3"}));
    EXPECT_TRUE(rejects(m, "cameras.txt", "5 SIMPLE", "-5 SIMPLE", {"cameras.txt:4", "'-5'"}));
    EXPECT_TRUE(rejects(m, "images.txt", "5 5 a name", "5 6 a name",
                        {"image 9", "camera 6", "no such camera"}));
    EXPECT_TRUE(rejects(m, "images.txt", "9 1 0 0 0", "9 0 0 0 0", {"image 9", "quaternion"}));
    EXPECT_TRUE(rejects(m, "images.txt", "9 1 0 0 0", "4 1 0 0 0", {"two images", "4"}));
    EXPECT_TRUE(rejects(m, "images.txt", "300 200 70 10", "300 200 10", {"images.txt:6"}));
    EXPECT_TRUE(rejects(m, "images.txt", "300 200 70", "300 200 71",
                        {"point 70", "feature 1 of image 9", "names point 71"}));
    EXPECT_TRUE(rejects(m, "images.txt", "300 200 70", "300 200 -1",
                        {"point 70", "feature 1 of image 9", "names no point"}));
    EXPECT_TRUE(rejects(m, "images.txt", "1.5 2.5 -1", "1.5 2.5 70",
                        {"feature 0 of image 9", "names point 70", "track"}));
    EXPECT_TRUE(rejects(m, "images.txt", "1.5 2.5 -1", "1.5 2.5 8",
                        {"feature 0 of image 9", "names point 8", "no such point"}));
    EXPECT_TRUE(
        rejects(m, "points3D.txt", "9 1 4 1", "8 1 4 1", {"point 70", "image 8", "no such image"}));
    EXPECT_TRUE(rejects(m, "points3D.txt", "9 1 4 1", "9 4 4 1",
                        {"point 70", "feature 4 of image 9", "4 features"}));
    EXPECT_TRUE(rejects(m, "points3D.txt", "4 1 4 0", "4 1 4 1", {"point 70", "twice"}));
    EXPECT_TRUE(rejects(m, "points3D.txt", "4 1 4 0", "4 1 4", {"points3D.txt:5", "feature"}));
    EXPECT_TRUE(rejects(m, "points3D.txt", "255", "256", {"points3D.txt:5", "'256'", "255"}));
    EXPECT_TRUE(rejects(m, "points3D.txt", "\n6 0", "\n70 0", {"two points", "70"}));
    const Files f = with_frames();
    EXPECT_TRUE(rejects(f, "rigs.txt", "IMU 1", "LIDAR 1", {"rigs.txt:4", "LIDAR"}));
    EXPECT_TRUE(rejects(f, "rigs.txt", "\n1 1", "\n8 1", {"two rigs", "8"}));
    EXPECT_TRUE(rejects(f, "frames.txt", "\n31 1", "\n31 2", {"frame 31", "rig 2"}));
    EXPECT_TRUE(rejects(f, "frames.txt", "CAMERA 5 4", "CAMERA 3 4", {"frame 31", "sensor 3"}));
    EXPECT_TRUE(rejects(f, "frames.txt", "CAMERA 5 4", "CAMERA 5 9", {"frame 31", "image 9"}));
    EXPECT_TRUE(rejects(f, "frames.txt", "1 CAMERA 5 4", "0", {"image 4", "no frame"}));
    EXPECT_TRUE(rejects(f, "frames.txt", "5 9 CAMERA 3 2", "5 2 CAMERA 3 9",
                        {"frame 30", "image 2", "camera 3"}));
    Files one = f;
    one.erase("frames.txt");
    EXPECT_TRUE(throws([&] { read_colmap_text(put("one", one)); }, Status::format, {"frames"}));
}

// Every way to cut a file short or to spoil a byte is an error that names the file, or gives a
// problem that is valid.
TEST_F(ColmapTest, DamagedBinaryFiles) {
    const Files binary = binary_of(with_frames());
    const std::string path = put("damaged", binary);
    const auto read = [&] {
        try {
            read_colmap_binary(path).problem.validate();
            return true;
        } catch (const Error& error) {
            EXPECT_EQ(error.status(), Status::format) << error.what();
            EXPECT_NE(std::string(error.what()).find(path), std::string::npos) << error.what();
            return false;
        }
    };
    EXPECT_TRUE(read());
    for (const auto& [name, content] : binary) {
        const auto put_file = [&](const std::string& bytes) {
            folder.file("damaged/" + name, bytes);
        };
        for (size_t size = 0; size < content.size(); size += 3) {
            put_file(content.substr(0, size));
            EXPECT_FALSE(read()) << name << " cut to " << size;
        }
        put_file(content + '\0');
        EXPECT_FALSE(read()) << name;
        for (size_t at = 0; at < content.size(); at += 2) {
            std::string spoiled = content;
            spoiled[at] = static_cast<char>(0xff);
            put_file(spoiled);
            read();
        }
        put_file(content);
    }
}

TEST_F(ColmapTest, CountsBeyondTheFileAskForNoMemory) {
    const Files binary = binary_of(with_frames());
    for (const auto& [name, content] : binary) {
        Files changed = binary;
        for (size_t k = 0; k < 7; ++k) changed[name][k] = static_cast<char>(0xff);
        const std::string path = put("changed", changed);
        EXPECT_TRUE(throws([&] { read_colmap_binary(path); }, Status::format,
                           {name, "claims 72057594037927935"}));
    }
}

TEST_F(ColmapTest, ProblemsWithoutIdsAndFeatures) {
    Reconstruction r;
    r.problem = test::small_scene(5, 20, {camera_radial, camera_opencv}, true, 3);
    write_colmap_binary(r, folder.path("model"));
    const Reconstruction read = read_colmap_binary(folder.path("model"));
    EXPECT_EQ(read.images[0].name, "image000001");
    EXPECT_EQ(read.points[19].id, 20u);
    EXPECT_EQ(read.problem.num_observations(), r.problem.num_observations());
    EXPECT_TRUE(read.unmatched.empty());
    EXPECT_NEAR(reference::residual(read.problem, nullptr).cost,
                reference::residual(r.problem, nullptr).cost, 1e-9);
}

// Other formats number features with gaps, and one feature may see two points.
TEST_F(ColmapTest, FeaturesAreNumberedByRank) {
    Reconstruction r = read_colmap_text(put("model", small_model));
    r.observation_features = {7, 7, 100, 100, 7};
    r.unmatched = {{0, 50, 1.5, 2.5}};
    r.problem.points[0][0] = 0;
    write_colmap_binary(r, folder.path("written"));
    const Reconstruction read = read_colmap_binary(folder.path("written"));
    EXPECT_EQ(read.observation_features, (std::vector<int32_t>{0, 0, 2, 2, 1}));
    ASSERT_EQ(read.unmatched.size(), 1u);
    EXPECT_EQ(read.unmatched[0].index, 1);
    for (size_t i = 0; i < 5; ++i)
        EXPECT_EQ(read.problem.observations[i].x, r.problem.observations[i].x);
}

TEST_F(ColmapTest, IdsThatColmapCannotHoldAreGivenAnew) {
    Reconstruction r = read_colmap_text(put("model", small_model));
    r.images[1].id = uint64_t{1} << 40;
    r.points[1].id = r.points[0].id;
    write_colmap_binary(r, folder.path("written"));
    const Reconstruction read = read_colmap_binary(folder.path("written"));
    EXPECT_EQ(read.images[2].id, 3u);
    EXPECT_EQ(read.points[1].id, 2u);
    EXPECT_EQ(read.cameras[0].id, 5u);
}

TEST_F(ColmapTest, AFailedWriteLeavesWhatWasThere) {
    const Reconstruction r = read_colmap_text(put("model", small_model));
    const Files before{{"images.bin", "old"}, {"frames.bin", "old"}, {"note", "mine"}};
    put("target", before);
    std::filesystem::create_directory(folder.path("target/points3D.bin"));
    EXPECT_TRUE(throws([&] { write_colmap_binary(r, folder.path("target")); }, Status::file,
                       {"points3D.bin"}));
    std::filesystem::remove(folder.path("target/points3D.bin"));
    EXPECT_EQ(get(folder.path("target")), before);
    // Rigs and frames of the model that was there would be taken for those of the new one.
    folder.file("target/rigs.bin", "old");
    write_colmap_binary(r, folder.path("target"));
    EXPECT_EQ(get(folder.path("target")).count("frames.bin"), 0u);
    EXPECT_EQ(get(folder.path("target")).count("rigs.bin"), 0u);
    EXPECT_EQ(get(folder.path("target")).at("note"), "mine");
    EXPECT_TRUE(throws([&] { write_colmap_text(r, folder.path("target")); }, Status::file,
                       {"binary", "another folder"}));
    EXPECT_TRUE(throws([&] { write_colmap_text(r, folder.path("absent/new")); }, Status::file,
                       {"absent/new"}));
    EXPECT_TRUE(throws([&] { write_colmap_text(r, folder.path("model/images.txt")); }, Status::file,
                       {"images.txt"}));
    Reconstruction lines = r;
    lines.images[0].name = "two\nlines";
    EXPECT_TRUE(throws([&] { write_colmap_text(lines, folder.path("new")); },
                       Status::invalid_argument, {"image 9", "lines"}));
    EXPECT_FALSE(std::filesystem::exists(folder.path("new")));
}

TEST_F(ColmapTest, SnavelyCamerasBecomeRadialAndBack) {
    const Problem start = test::small_scene(6, 30, {camera_snavely}, false, 4);
    Reconstruction r;
    r.problem = start;
    const Reconstruction pixels = with_pixel_cameras(r);
    const double cost = reference::residual(start, nullptr).cost;
    EXPECT_NEAR(reference::residual(pixels.problem, nullptr).cost, cost, 1e-9 * cost);
    for (const Observation& o : pixels.problem.observations) {
        const CameraInfo& size = pixels.cameras[pixels.problem.images[o.image].camera];
        EXPECT_TRUE(o.x >= 0 && o.x <= static_cast<double>(size.width));
        EXPECT_TRUE(o.y >= 0 && o.y <= static_cast<double>(size.height));
    }
    const Problem back = with_snavely_cameras(pixels.problem);
    for (int32_t i = 0; i < start.num_images(); ++i) {
        const auto expected = rotation_matrix(start.images[i].pose.rotation);
        const auto matrix = rotation_matrix(back.images[i].pose.rotation);
        for (int k = 0; k < 9; ++k) EXPECT_NEAR(matrix[k], expected[k], 1e-14);
        EXPECT_EQ(back.images[i].pose.translation, start.images[i].pose.translation);
        EXPECT_EQ(back.cameras[i].params, start.cameras[i].params);
    }
    for (size_t i = 0; i < start.observations.size(); ++i) {
        EXPECT_NEAR(back.observations[i].x, start.observations[i].x, 1e-12);
        EXPECT_NEAR(back.observations[i].y, start.observations[i].y, 1e-12);
    }
}

TEST_F(ColmapTest, CamerasThatSnavelyCanHold) {
    for (const int32_t model : {camera_simple_pinhole, camera_simple_radial, camera_radial}) {
        const Problem start = test::small_scene(6, 30, {model}, true, 4);
        const double cost = reference::residual(start, nullptr).cost;
        EXPECT_NEAR(reference::residual(with_snavely_cameras(start), nullptr).cost, cost,
                    1e-9 * cost);
    }
    const Problem opencv = test::small_scene(3, 10, {camera_radial, camera_opencv}, false, 4);
    EXPECT_TRUE(throws([&] { with_snavely_cameras(opencv); }, Status::invalid_argument,
                       {"cameras[1]", "opencv"}));
}

TEST_F(ColmapTest, FormatsAreToldByContent) {
    const auto format_of = [](const std::string& path) {
        return read_reconstruction(path, Format::automatic, {}).format;
    };
    const std::string text_model = put("text", small_model);
    binary_of(small_model);
    EXPECT_EQ(format_of(text_model), Format::colmap_text);
    EXPECT_EQ(format_of(folder.path("binary")), Format::colmap_binary);
    EXPECT_EQ(format_of(folder.file("x.ply", " 0 0 0")), Format::bal);
    EXPECT_TRUE(throws([&] { format_of(folder.file("picture.txt", "\x89PNG")); }, Status::format,
                       {"picture.txt", "bal", "colmap_text"}));
    EXPECT_TRUE(throws([&] { format_of(folder.file("empty", "")); }, Status::format, {"empty"}));
    EXPECT_TRUE(throws([&] { read_reconstruction("x.ply", Format::ply, {}); },
                       Status::invalid_argument, {"only written"}));

    EXPECT_EQ(format_for_output("out/", Format::bal), Format::colmap_binary);
    EXPECT_EQ(format_for_output("out/", Format::colmap_text), Format::colmap_text);
    EXPECT_EQ(format_for_output(text_model, Format::automatic), Format::colmap_binary);
    EXPECT_EQ(format_for_output("out", Format::colmap_text), Format::colmap_text);
    EXPECT_EQ(format_for_output("out.txt.bz2", Format::colmap_text), Format::bal);
    EXPECT_EQ(format_for_output("out.ply", Format::bal), Format::ply);
    EXPECT_TRUE(throws([] { format_for_output("out", Format::automatic); },
                       Status::invalid_argument, {"out", "format"}));
}

TEST_F(ColmapTest, ProgressGrowsToTheEndAndMayStop) {
    const std::string text_model = put("text", small_model);
    binary_of(small_model);
    for (const std::string& path : {text_model, folder.path("binary")}) {
        double last = 0;
        read_reconstruction(path, Format::automatic, [&](double share) {
            EXPECT_GE(share, last);
            last = share;
            return false;
        });
        EXPECT_GT(last, 0.5);
        EXPECT_LE(last, 1);
        EXPECT_TRUE(throws(
            [&] { read_reconstruction(path, Format::automatic, [](double) { return true; }); },
            Status::cancelled, {"progress"}));
    }
    ReadProgress::add(1);  // nobody listens
}

TEST_F(ColmapTest, WhatNoLongerFitsIsDropped) {
    Reconstruction r = read_colmap_text(put("model", with_frames()));
    r.problem.points.emplace_back();
    r.problem.observations.clear();
    drop_mismatched(r);
    EXPECT_TRUE(r.points.empty() && r.observation_features.empty() && r.unmatched.empty());
    EXPECT_EQ(r.images.size(), 3u);
    EXPECT_EQ(r.frames.size(), 2u);
    r.problem.images.pop_back();
    drop_mismatched(r);
    EXPECT_TRUE(r.images.empty() && r.frames.empty() && r.rigs.empty() && !r.has_frames);
    EXPECT_EQ(r.cameras.size(), 2u);
    write_colmap_text(r, folder.path("rest"));
    EXPECT_EQ(read_colmap_text(folder.path("rest")).cameras[1].width, 800u);
}

}  // namespace
}  // namespace clba
