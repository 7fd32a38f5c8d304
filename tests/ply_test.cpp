// SPDX-License-Identifier: Apache-2.0
#include "io/ply.hpp"

#include <gtest/gtest.h>

#include <cstring>

#include "temporary_folder.hpp"

namespace clba {
namespace {

using test::content_of;
using test::TemporaryFolder;
using test::throws;

constexpr size_t vertex_bytes = 3 * 8 + 3;

Problem two_points_one_image() {
    Problem problem;
    problem.cameras.resize(1);
    Image image;
    image.pose.rotation = quaternion_from_rotation_vector({0.3, -0.2, 0.1});
    image.pose.translation = {1, 2, 3};
    problem.images.push_back(image);
    problem.points = {{1.5, -2.25, 1e-300}, {4, 5, 6}};
    return problem;
}

struct Vertex {
    Point position;
    int red, green, blue;
};

Vertex vertex_at(const std::string& data, size_t index) {
    const char* bytes = data.data() + index * vertex_bytes;
    Vertex vertex;
    for (int k = 0; k < 3; ++k) {
        uint64_t bits = 0;
        for (int b = 7; b >= 0; --b)
            bits = bits << 8 | static_cast<unsigned char>(bytes[8 * k + b]);
        std::memcpy(&vertex.position[k], &bits, 8);
    }
    vertex.red = static_cast<unsigned char>(bytes[24]);
    vertex.green = static_cast<unsigned char>(bytes[25]);
    vertex.blue = static_cast<unsigned char>(bytes[26]);
    return vertex;
}

TEST(PlyTest, HoldsPointsInWhiteAndCentersInGreen) {
    const TemporaryFolder folder;
    const Problem problem = two_points_one_image();
    write_ply(problem, folder.path("scene.ply"));
    const std::string content = content_of(folder.path("scene.ply"));
    const std::string header =
        "ply\n"
        "format binary_little_endian 1.0\n"
        "element vertex 3\n"
        "property double x\n"
        "property double y\n"
        "property double z\n"
        "property uchar red\n"
        "property uchar green\n"
        "property uchar blue\n"
        "end_header\n";
    ASSERT_EQ(content.substr(0, header.size()), header);
    const std::string data = content.substr(header.size());
    ASSERT_EQ(data.size(), 3 * vertex_bytes);
    for (size_t i = 0; i < 2; ++i) {
        const Vertex point = vertex_at(data, i);
        EXPECT_EQ(point.position, problem.points[i]);
        EXPECT_EQ(point.red, 255);
        EXPECT_EQ(point.green, 255);
        EXPECT_EQ(point.blue, 255);
    }
    const Vertex center = vertex_at(data, 2);
    EXPECT_EQ(center.position, camera_center(problem.images[0].pose));
    EXPECT_EQ(center.red, 0);
    EXPECT_EQ(center.green, 255);
    EXPECT_EQ(center.blue, 0);
}

TEST(PlyTest, WritesManyBlocks) {
    const TemporaryFolder folder;
    Problem problem = two_points_one_image();
    for (int i = 0; i < 100000; ++i) problem.points.push_back({1.0 * i, 0.5 * i, -1.0 * i});
    write_ply(problem, folder.path("scene.ply"));
    const std::string content = content_of(folder.path("scene.ply"));
    const size_t header = content.find("end_header\n") + 11;
    ASSERT_EQ(content.size() - header, 100003 * vertex_bytes);
    for (size_t i : {size_t{2}, size_t{50000}, size_t{100001}})
        EXPECT_EQ(vertex_at(content.substr(header), i).position, problem.points[i]) << i;
}

TEST(PlyTest, EmptyProblemsAreEmptyFiles) {
    const TemporaryFolder folder;
    write_ply(Problem(), folder.path("scene.ply"));
    const std::string content = content_of(folder.path("scene.ply"));
    EXPECT_NE(content.find("element vertex 0\n"), std::string::npos);
    EXPECT_EQ(content.substr(content.size() - 11), "end_header\n");
}

TEST(PlyTest, FailedWritesLeaveNothing) {
    const TemporaryFolder folder;
    EXPECT_TRUE(throws([&] { write_ply(Problem(), folder.path("absent/scene.ply")); }, Status::file,
                       {"cannot write", "absent/scene.ply"}));
    EXPECT_EQ(folder.num_files(), 0u);
}

}  // namespace
}  // namespace clba
