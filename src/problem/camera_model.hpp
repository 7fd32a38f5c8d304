// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>

namespace clba {

struct CameraModel {
    const char* name;
    int num_params;
    const char* param_names;  // separated by commas, in order
    int num_kept;             // values of a view that kernels keep with it
};

enum CameraModelNumber : int32_t {
#define CLBA_CAMERA_MODEL(name, number, num_params, param_names, num_kept) camera_##name = number,
#include "problem/camera_models.def"
#undef CLBA_CAMERA_MODEL
};

inline constexpr CameraModel camera_models[] = {
#define CLBA_CAMERA_MODEL(name, number, num_params, param_names, num_kept) \
    {#name, num_params, param_names, num_kept},
#include "problem/camera_models.def"
#undef CLBA_CAMERA_MODEL
};
inline constexpr int num_camera_models = sizeof(camera_models) / sizeof(camera_models[0]);

constexpr int most_camera_params() {
    int most = 0;
    for (const CameraModel& model : camera_models)
        if (model.num_params > most) most = model.num_params;
    return most;
}
inline constexpr int max_camera_params = most_camera_params();
inline constexpr int num_pose_params = 6;  // of the tangent: rotation, position

constexpr bool is_camera_model(int32_t number) {
    return number >= 0 && number < num_camera_models;
}

}  // namespace clba
