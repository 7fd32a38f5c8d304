// SPDX-License-Identifier: Apache-2.0
#include "io/losses.hpp"

#include <algorithm>

#include "base/error.hpp"
#include "io/convert.hpp"

namespace clba {
namespace {

int32_t num_shared_cameras(const Problem& problem) {
    std::vector<int32_t> uses(problem.cameras.size());
    for (const Image& image : problem.images) ++uses[image.camera];
    return static_cast<int32_t>(
        std::count_if(uses.begin(), uses.end(), [](int32_t count) { return count > 1; }));
}

int32_t num_unused_cameras(const Problem& problem) {
    std::vector<char> is_used(problem.cameras.size());
    for (const Image& image : problem.images) is_used[image.camera] = 1;
    return static_cast<int32_t>(std::count(is_used.begin(), is_used.end(), 0));
}

}  // namespace

std::vector<std::string> losses_of_bal(const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    require_snavely_like_cameras(problem);
    std::vector<std::string> losses;
    if (const int32_t count = num_shared_cameras(problem))
        losses.push_back(text("that images share ", count, " of the cameras"));
    if (const int32_t count = num_unused_cameras(problem))
        losses.push_back(text(count, " cameras that no image has"));
    const auto num_pixel_cameras =
        std::count_if(problem.cameras.begin(), problem.cameras.end(),
                      [](const Camera& camera) { return camera.model != camera_snavely; });
    if (num_pixel_cameras > 0)
        losses.push_back(
            text("the models and principal points of ", num_pixel_cameras, " cameras"));
    if (!reconstruction.cameras.empty()) losses.push_back("ids of cameras and sizes of images");
    if (!reconstruction.images.empty()) losses.push_back("names and ids of images");
    if (!reconstruction.points.empty()) losses.push_back("ids and colours of points");
    if (!reconstruction.unmatched.empty())
        losses.push_back(text(reconstruction.unmatched.size(), " features without a point"));
    if (!reconstruction.frames.empty()) losses.push_back("rigs and frames");
    return losses;
}

}  // namespace clba
