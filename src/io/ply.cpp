// SPDX-License-Identifier: Apache-2.0
#include "io/ply.hpp"

#include <cstdint>
#include <cstring>

#include "base/atomic_file.hpp"
#include "base/error.hpp"

namespace clba {
namespace {

constexpr size_t block_bytes = size_t{1} << 20;

struct Color {
    char red, green, blue;
};
constexpr char full = static_cast<char>(255);
constexpr Color white{full, full, full};
constexpr Color green{0, full, 0};

void put_vertex(std::string& block, const Point& position, Color color) {
    for (double value : position) {
        uint64_t bits;
        std::memcpy(&bits, &value, sizeof bits);
        for (int shift = 0; shift < 64; shift += 8) block += static_cast<char>(bits >> shift & 255);
    }
    block += color.red;
    block += color.green;
    block += color.blue;
}

}  // namespace

void write_ply(const Problem& problem, const std::string& path) {
    AtomicFile file(path);
    std::string block =
        text("ply\nformat binary_little_endian 1.0\nelement vertex ",
             problem.points.size() + problem.images.size(),
             "\nproperty double x\nproperty double y\nproperty double z\n"
             "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n");
    const auto flush_if_full = [&] {
        if (block.size() < block_bytes) return;
        file.write(block);
        block.clear();
    };
    for (const Point& point : problem.points) {
        put_vertex(block, point, white);
        flush_if_full();
    }
    for (const Image& image : problem.images) {
        put_vertex(block, camera_center(image.pose), green);
        flush_if_full();
    }
    file.write(block);
    file.commit();
}

}  // namespace clba
