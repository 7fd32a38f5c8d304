// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "linear/device_problem.hpp"

namespace clba {

// The images of a problem that are in rigs, on the device: their poses by those of frames and
// sensors, and the linear map T from F vectors of parameters to F vectors of images, by which what
// kernels over observations make of each image's pose becomes that of parameters (kernels/rigs.cl).
// T is that of the device's state.
class RigTangents {
public:
    RigTangents(DeviceProblem& device, const Problem& problem);

    // Buffers of a state: poses of the frames and sensors of these images, and what T reads.
    void add_buffers(State& state) const;
    void upload(const Problem& problem, State& state);          // and composes
    void download(const State& state, Problem& problem) const;  // images are composed
    std::vector<Pose> download_sensors(const State& state, const std::vector<Pose>& before) const;
    void update_records(const State& of);
    // Moves frames and sensors, and composes the images of `to`.
    void move(const Vector& step, const State& from, State& to);
    void compose(State& of);

    const Buffer& expand(const Buffer& x);  // T x; valid until the next
    Buffer& zeroed_image_vector();          // to be filled for
    void gather(Buffer& x);                 // x += T^T of it
    // For diagonal blocks of images, packed lower triangles, to become
    Buffer& image_matrices();
    // those of parameters: of frames the sum over images, of sensors likewise, without what two
    // images have in common. So they are those of J^T J; of the Schur complement a positive
    // semidefinite approximation.
    void transform_blocks(Buffer& matrices);
    void get_diagonal(const Buffer& matrices, Buffer& diagonal);

    const ParameterLayout& image_layout() const { return image_layout_; }
    // Offsets of poses in a step, for `update_images` over all images.
    const Buffer& step_offsets() const { return step_offsets_; }

private:
    struct Moves {  // kernels/rigs.cl, move_values
        int32_t count = 0;
        Buffer from, to;
    };
    Kernel& kernel(const char* name, const char* more = "");
    template <class... Arguments>
    void launch(Step step, const char* name, int64_t rows, const Arguments&... arguments);
    Moves make_moves(const std::vector<int32_t>& from, const std::vector<int32_t>& to);
    void list_offsets(const Problem& problem);
    void list_moves();

    DeviceProblem& device_;
    Queue& queue_;
    ParameterLayout image_layout_;
    int32_t num_images_ = 0, num_sensors_ = 0;         // composed; of them
    std::vector<int32_t> frames_, sensors_;            // the problem's rows of those in a state
    std::vector<int32_t> image_frame_, image_sensor_;  // of composed images, in these
    Buffer images_, device_image_frame_, device_image_sensor_;
    Buffer image_offset_, frame_offset_, sensor_offset_;  // of each composed image
    Buffer frame_images_;                                 // first of each frame, and end
    Buffer frame_step_offset_, sensor_step_offset_;       // of each frame and sensor
    Buffer sensor_images_, images_by_sensor_;
    Buffer frame_matrix_, image_matrix_, sensor_matrix_;
    Buffer step_offsets_;
    Moves values_;    // from F vectors of parameters to those of images, without composed poses
    Moves gathered_;  // back
    Moves matrices_;  // of diagonal blocks, from images to parameters, likewise
    Moves diagonal_;  // from matrices to scalars, of parameters
    Buffer expanded_, sums_, image_blocks_;
};

}  // namespace clba
