// SPDX-License-Identifier: Apache-2.0
#include "device/context.hpp"

#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <vector>

#include "base/error.hpp"
#include "clba/clba_version.h"
#include "device/kernel_source.hpp"
#include "device/opencl.hpp"

namespace clba {
namespace {

Tuning tuning_for(const DeviceInfo& device) {
    Tuning tuning;
    const bool is_oclgrind = device.name.find("Oclgrind") != std::string::npos;
    tuning.lane_loop = device.type == DeviceType::cpu || is_oclgrind;
    // oclgrind stops at the llvm.vector.reduce intrinsics that vectorised loops bring.
    tuning.vectorize = !is_oclgrind;
    if (tuning.lane_loop) {
        tuning.vector_groups = device.compute_units * 4;
        tuning.tile_groups = device.compute_units;
    } else {
        tuning.work_group_size =
            static_cast<int>(std::min<uint64_t>(128, device.max_work_group_size));
        tuning.vector_groups = device.compute_units * 8;
        tuning.tile_groups = device.compute_units * 8;
        tuning.points_per_tile = 512;
        tuning.pcg_interval = 4;
    }
    return tuning;
}

void require_writable(const std::string& folder) {
    std::error_code error;
    std::filesystem::create_directories(folder, error);
    if (error || ::access(folder.c_str(), W_OK | X_OK) != 0)
        fail(Status::file, "the kernel cache folder ", folder,
             " cannot be written; name another in CLBA_CACHE_DIR, or set it empty to keep none");
}

std::string build_log(cl_program program, cl_device_id device) {
    size_t bytes = 0;
    opencl().clGetProgramBuildInfo(program, device, CL_PROGRAM_BUILD_LOG, 0, nullptr, &bytes);
    std::string log(bytes, '\0');
    opencl().clGetProgramBuildInfo(program, device, CL_PROGRAM_BUILD_LOG, bytes, log.data(),
                                   nullptr);
    return log.c_str();
}

std::vector<unsigned char> program_binary(cl_program program) {
    size_t bytes = 0;
    if (opencl().clGetProgramInfo(program, CL_PROGRAM_BINARY_SIZES, sizeof bytes, &bytes,
                                  nullptr) != CL_SUCCESS)
        return {};
    std::vector<unsigned char> binary(bytes);
    unsigned char* pointer = binary.data();
    if (opencl().clGetProgramInfo(program, CL_PROGRAM_BINARIES, sizeof pointer, &pointer,
                                  nullptr) != CL_SUCCESS)
        return {};
    return binary;
}

}  // namespace

Context::Context(const ContextOptions& options) : cache_(options.cache_folder) {
    const bool is_callers = options.cl_context || options.cl_device || options.cl_queue;
    require(!is_callers || (options.cl_context && options.cl_device && options.cl_queue),
            "cl_context, cl_device_id and cl_command_queue go together: set all three or none");
    if (options.cache_is_required && !options.cache_folder.empty())
        require_writable(options.cache_folder);
    OpenCl& cl = opencl();
    if (is_callers) {
        device_ = describe_device(options.cl_device);
        check_opencl(cl.clRetainContext(options.cl_context), "clRetainContext");
        context_ = options.cl_context;
        const cl_int error = cl.clRetainCommandQueue(options.cl_queue);
        if (error != CL_SUCCESS) cl.clReleaseContext(context_);
        check_opencl(error, "clRetainCommandQueue");
        caller_queue_ = options.cl_queue;
    } else {
        device_ = select_device(options.device_index, options.device);
        cl_int error = CL_SUCCESS;
        context_ = cl.clCreateContext(nullptr, 1, &device_.id, nullptr, nullptr, &error);
        check_opencl(error, "clCreateContext", device_.name);
    }
    max_allocation_bytes_ = device_.max_allocation_bytes;
    if (options.max_allocation_bytes > 0)
        max_allocation_bytes_ = std::min(max_allocation_bytes_, options.max_allocation_bytes);
    tuning = tuning_for(device_);
}

Context::~Context() {
    OpenCl& cl = opencl();
    save_programs();
    programs_.clear();
    if (caller_queue_) cl.clReleaseCommandQueue(caller_queue_);
    cl.clReleaseContext(context_);
}

// Not when they are built: some compilers build a kernel at its first launch, and would do so once
// more to make the binary.
void Context::save_programs() noexcept {
    if (!cache_.is_enabled()) return;
    try {
        for (const auto& [key, program] : unsaved_) {
            const std::vector<unsigned char> binary = program_binary(program);
            if (!binary.empty()) cache_.store(key, binary);
        }
    } catch (const std::exception&) {
        // The next start compiles again.
    }
}

_cl_program* Context::program(const std::string& path, const std::string& camera_model_path,
                              const std::string& options) {
    const std::lock_guard lock(mutex_);
    const std::string key = path + '\n' + camera_model_path + '\n' + options;
    // Its place comes first, so that a program that is built has an owner.
    ProgramHandle& kept = programs_[key];
    if (kept) return kept.get();
    const auto start = std::chrono::steady_clock::now();
    kept = build(kernel_source(path, camera_model_path), options);
    build_seconds_ =
        build_seconds_ +
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return kept.get();
}

void Context::ReleaseProgram::operator()(_cl_program* program) const {
    opencl().clReleaseProgram(program);
}

Context::ProgramHandle Context::build(const std::string& source, const std::string& options) {
    OpenCl& cl = opencl();
    const std::string key = text(CLBA_VERSION, '\n', options, '\n', device_.platform, '\n',
                                 device_.platform_version, '\n', device_.vendor, '\n', device_.name,
                                 '\n', device_.version, '\n', device_.driver, '\n', source);
    const std::vector<unsigned char> binary = cache_.load(key);
    if (!binary.empty()) {
        const size_t bytes = binary.size();
        const unsigned char* pointer = binary.data();
        cl_int status = CL_SUCCESS, error = CL_SUCCESS;
        ProgramHandle program(cl.clCreateProgramWithBinary(context_, 1, &device_.id, &bytes,
                                                           &pointer, &status, &error));
        if (error == CL_SUCCESS && status == CL_SUCCESS &&
            cl.clBuildProgram(program.get(), 1, &device_.id, options.c_str(), nullptr, nullptr) ==
                CL_SUCCESS)
            return program;
    }
    const char* pointer = source.c_str();
    const size_t bytes = source.size();
    cl_int error = CL_SUCCESS;
    ProgramHandle program(cl.clCreateProgramWithSource(context_, 1, &pointer, &bytes, &error));
    check_opencl(error, "clCreateProgramWithSource");
    error = cl.clBuildProgram(program.get(), 1, &device_.id, options.c_str(), nullptr, nullptr);
    if (error != CL_SUCCESS)
        fail(Status::kernel_build, "clBuildProgram failed with ", opencl_error_name(error), " on ",
             device_.name, " with the options '", options, "':\n",
             build_log(program.get(), device_.id));
    unsaved_.emplace_back(key, program.get());
    return program;
}

}  // namespace clba
