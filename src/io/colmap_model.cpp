// SPDX-License-Identifier: Apache-2.0
#include "io/colmap_model.hpp"

#include <cctype>
#include <cmath>
#include <filesystem>

#include "base/error.hpp"

namespace clba::colmap {
namespace {

// Those of COLMAP 4, by its numbers, for messages.
constexpr const char* names[] = {"SIMPLE_PINHOLE",
                                 "PINHOLE",
                                 "SIMPLE_RADIAL",
                                 "RADIAL",
                                 "OPENCV",
                                 "OPENCV_FISHEYE",
                                 "FULL_OPENCV",
                                 "FOV",
                                 "SIMPLE_RADIAL_FISHEYE",
                                 "RADIAL_FISHEYE",
                                 "THIN_PRISM_FISHEYE",
                                 "RAD_TAN_THIN_PRISM_FISHEYE"};
constexpr int32_t num_names = sizeof names / sizeof names[0];

// clba's numbers are COLMAP's + 1; 0 is snavely, which COLMAP does not have.
constexpr int32_t first_number = 1, end_number = camera_thin_prism_fisheye + 1;

[[noreturn]] void fail_unknown(const std::string& where, uint32_t camera,
                               const std::string& model) {
    std::string known;
    for (int32_t number = first_number; number < end_number; ++number)
        known += (known.empty() ? "" : ", ") + model_name(number);
    fail(Status::format, where, ": camera ", camera, " has the model ", model, ", but clba has ",
         known, "; undistort its images, or fit one of these models");
}

}  // namespace

bool has_frame_files(const std::string& folder, const std::string& ending) {
    const auto exists = [&](const std::string& name) {
        std::error_code error;
        return std::filesystem::exists(folder + "/" + name + ending, error);
    };
    const bool has_rigs = exists("rigs"), has_frames = exists("frames");
    if (has_rigs != has_frames)
        fail(Status::format, folder, " has ", has_rigs ? "rigs" : "frames", ending, " but no ",
             has_rigs ? "frames" : "rigs", ending, "; a model has both or neither");
    return has_frames;
}

bool can_be_normalized(const Pose& pose) {
    double norm2 = 0;
    for (double q : normalized(pose.rotation)) norm2 += q * q;
    return std::abs(norm2 - 1) < 1e-6;  // false: 0, or too large to be squared
}

int32_t model_id(int32_t number) {
    return number - first_number;
}

std::string model_name(int32_t number) {
    std::string name = camera_models[number].name;
    for (char& c : name) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    return name;
}

int32_t number_of_model_id(int32_t id, uint32_t camera, const std::string& where) {
    if (id >= 0 && id < end_number - first_number) return id + first_number;
    fail_unknown(where, camera, id >= 0 && id < num_names ? names[id] : text("number ", id));
}

int32_t number_of_model_name(std::string_view name, uint32_t camera, const std::string& where) {
    for (int32_t number = first_number; number < end_number; ++number)
        if (model_name(number) == name) return number;
    fail_unknown(where, camera, std::string(name));
}

}  // namespace clba::colmap
