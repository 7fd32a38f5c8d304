// SPDX-License-Identifier: Apache-2.0
#include "io/losses.hpp"

#include <algorithm>
#include <string_view>

#include "base/error.hpp"
#include "io/colmap_frames.hpp"
#include "io/convert.hpp"
#include "io/nvm.hpp"
#include "io/openmvg.hpp"

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

bool is_from(const Reconstruction& reconstruction, std::string_view format) {
    return reconstruction.details && reconstruction.details->format == format;
}

// Of formats where each image has a camera of its own without a principal point.
void add_camera_losses(const Problem& problem, std::vector<std::string>& losses) {
    if (const int32_t count = num_shared_cameras(problem))
        losses.push_back(text("that images share ", count, " of the cameras"));
    if (const int32_t count = num_unused_cameras(problem))
        losses.push_back(text(count, " cameras that no image has"));
}

void add_rig_losses(const Reconstruction& reconstruction, std::vector<std::string>& losses) {
    if (!reconstruction.frames.empty() || !reconstruction.problem.rigs.empty())
        losses.push_back("rigs and frames");
}

void add_file_losses(const Reconstruction& reconstruction, std::vector<std::string>& losses) {
    if (!reconstruction.unmatched.empty())
        losses.push_back(text(reconstruction.unmatched.size(), " features without a point"));
    const auto* details = reconstruction.details.get();
    if (details && details->has_content)
        losses.push_back(text("what only files of the format ", details->format, " hold"));
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
    add_rig_losses(reconstruction, losses);
    return losses;
}

std::vector<std::string> losses_of_colmap(const Reconstruction& reconstruction) {
    if (colmap::can_hold_rigs(reconstruction.problem)) return {};
    return {
        "rigs where a sensor has several cameras, or shares one with another sensor or with images "
        "of no rig"};
}

std::vector<std::string> losses_of_bundler(const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    require_snavely_like_cameras(problem);
    std::vector<std::string> losses;
    add_camera_losses(problem, losses);
    if (!has_snavely_cameras_only(problem)) losses.push_back("principal points");
    add_rig_losses(reconstruction, losses);
    if (is_from(reconstruction, "bundler")) return losses;
    if (!reconstruction.cameras.empty()) losses.push_back("ids of cameras and sizes of images");
    if (!reconstruction.images.empty()) losses.push_back("ids of images");
    if (!reconstruction.points.empty()) losses.push_back("ids of points");
    add_file_losses(reconstruction, losses);
    return losses;
}

std::vector<std::string> losses_of_nvm(const Reconstruction& reconstruction) {
    const Problem& problem = reconstruction.problem;
    require_nvm_cameras(problem);
    std::vector<std::string> losses;
    add_camera_losses(problem, losses);
    add_rig_losses(reconstruction, losses);
    if (is_from(reconstruction, "nvm")) return losses;
    if (!has_snavely_cameras_only(problem)) losses.push_back("principal points");
    if (!reconstruction.cameras.empty()) losses.push_back("ids of cameras and sizes of images");
    if (!reconstruction.images.empty()) losses.push_back("ids of images");
    if (!reconstruction.points.empty()) losses.push_back("ids of points");
    add_file_losses(reconstruction, losses);
    return losses;
}

std::vector<std::string> losses_of_openmvg(const Reconstruction& reconstruction) {
    require_openmvg_cameras(reconstruction.problem);
    std::vector<std::string> losses;
    add_rig_losses(reconstruction, losses);
    if (is_from(reconstruction, "openmvg")) return losses;
    if (!reconstruction.points.empty()) losses.push_back("colours of points");
    add_file_losses(reconstruction, losses);
    return losses;
}

std::vector<std::string> losses_of_opensfm(const Reconstruction& reconstruction) {
    std::vector<std::string> losses;
    add_rig_losses(reconstruction, losses);
    if (is_from(reconstruction, "opensfm")) return losses;
    if (!reconstruction.cameras.empty()) losses.push_back("ids of cameras");
    if (!reconstruction.images.empty()) losses.push_back("ids of images");
    if (!reconstruction.points.empty()) losses.push_back("ids of points");
    add_file_losses(reconstruction, losses);
    return losses;
}

}  // namespace clba
