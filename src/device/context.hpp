// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <atomic>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "device/device_info.hpp"
#include "device/program_cache.hpp"

struct _cl_context;
struct _cl_command_queue;
struct _cl_program;

namespace clba {

struct ContextOptions {
    int device_index = -1;
    std::string device;  // see select_device
    std::string cache_folder;
    bool cache_is_required = false;     // the folder was named: it must be writable
    uint64_t max_allocation_bytes = 0;  // 0: the device's limit
    // The caller's own; all or none. Retained.
    _cl_context* cl_context = nullptr;
    _cl_device_id* cl_device = nullptr;
    _cl_command_queue* cl_queue = nullptr;
};

// How kernels are shaped for the device (kernels/lanes.clh).
struct Tuning {
    bool lane_loop = true;  // work-groups of one work-item with inner loops: CPUs
    bool vectorize = true;  // ask the compiler to vectorise these loops
    int work_group_size = 1;
    int vector_groups = 1;            // work-groups for kernels over vectors
    int tile_groups = 1;              // work-groups that share tiles out among themselves
    int pcg_interval = 1;             // iterations of PCG between looks at how it goes
    int lanes = 16;                   // padding of runs
    int32_t points_per_tile = 32768;  // at most
};

// One device and the programs built for it. May be used by several threads at a time.
class Context {
public:
    explicit Context(const ContextOptions& options);
    ~Context();
    Context(const Context&) = delete;
    Context& operator=(const Context&) = delete;

    const DeviceInfo& device() const { return device_; }
    uint64_t max_allocation_bytes() const { return max_allocation_bytes_; }
    // Tests set these before they make a queue.
    Tuning tuning;

    // The program of kernels/<path> with these -D options, from memory, from the cache on disk or
    // by compiling it. Throws kernel_build with the compiler's log. The context keeps the program.
    _cl_program* program(const std::string& path, const std::string& camera_model_path,
                         const std::string& options);
    double build_seconds() const { return build_seconds_; }  // so far

    _cl_context* cl_context() const { return context_; }
    _cl_command_queue* caller_queue() const { return caller_queue_; }

private:
    void save_programs() noexcept;
    struct ReleaseProgram {
        void operator()(_cl_program* program) const;
    };
    using ProgramHandle = std::unique_ptr<_cl_program, ReleaseProgram>;
    ProgramHandle build(const std::string& source, const std::string& options);

    DeviceInfo device_;
    uint64_t max_allocation_bytes_ = 0;
    ProgramCache cache_;
    _cl_context* context_ = nullptr;
    _cl_command_queue* caller_queue_ = nullptr;
    std::mutex mutex_;  // guards programs_
    std::map<std::string, ProgramHandle> programs_;
    std::vector<std::pair<std::string, _cl_program*>> unsaved_;  // with their keys in the cache
    std::atomic<double> build_seconds_{0};
};

}  // namespace clba
