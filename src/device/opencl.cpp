// SPDX-License-Identifier: Apache-2.0
#include "device/opencl.hpp"

#include "base/dynamic_library.hpp"
#include "base/error.hpp"

namespace clba {
namespace {

OpenCl load_opencl() {
    const DynamicLibrary library({"libOpenCL.so.1", "libOpenCL.so", "libOpenCL.dylib"});
    if (!library.is_open())
        fail(Status::no_device, "no OpenCL loader was found (", library.error(),
             "); install one, as ocl-icd-libopencl1 on Debian, and a driver: a GPU vendor's, or "
             "pocl-opencl-icd for the CPU");
    OpenCl table;
#define CLBA_LOAD(name)                                                              \
    table.name = library.symbol<std::remove_pointer_t<decltype(table.name)>>(#name); \
    if (!table.name) fail(Status::no_device, "the OpenCL loader has no function " #name);
    CLBA_OPENCL_FUNCTIONS(CLBA_LOAD)
#undef CLBA_LOAD
    return table;
}

}  // namespace

OpenCl& opencl() {
    static OpenCl table = load_opencl();
    return table;
}

const char* opencl_error_name(cl_int error) {
    switch (error) {
#define CLBA_NAME(code) \
    case code:          \
        return #code;
        CLBA_NAME(CL_SUCCESS)
        CLBA_NAME(CL_DEVICE_NOT_FOUND)
        CLBA_NAME(CL_DEVICE_NOT_AVAILABLE)
        CLBA_NAME(CL_COMPILER_NOT_AVAILABLE)
        CLBA_NAME(CL_MEM_OBJECT_ALLOCATION_FAILURE)
        CLBA_NAME(CL_OUT_OF_RESOURCES)
        CLBA_NAME(CL_OUT_OF_HOST_MEMORY)
        CLBA_NAME(CL_PROFILING_INFO_NOT_AVAILABLE)
        CLBA_NAME(CL_BUILD_PROGRAM_FAILURE)
        CLBA_NAME(CL_MAP_FAILURE)
        CLBA_NAME(CL_INVALID_VALUE)
        CLBA_NAME(CL_INVALID_PLATFORM)
        CLBA_NAME(CL_INVALID_DEVICE)
        CLBA_NAME(CL_INVALID_CONTEXT)
        CLBA_NAME(CL_INVALID_QUEUE_PROPERTIES)
        CLBA_NAME(CL_INVALID_COMMAND_QUEUE)
        CLBA_NAME(CL_INVALID_MEM_OBJECT)
        CLBA_NAME(CL_INVALID_BINARY)
        CLBA_NAME(CL_INVALID_BUILD_OPTIONS)
        CLBA_NAME(CL_INVALID_PROGRAM)
        CLBA_NAME(CL_INVALID_PROGRAM_EXECUTABLE)
        CLBA_NAME(CL_INVALID_KERNEL_NAME)
        CLBA_NAME(CL_INVALID_KERNEL)
        CLBA_NAME(CL_INVALID_ARG_INDEX)
        CLBA_NAME(CL_INVALID_ARG_VALUE)
        CLBA_NAME(CL_INVALID_ARG_SIZE)
        CLBA_NAME(CL_INVALID_KERNEL_ARGS)
        CLBA_NAME(CL_INVALID_WORK_GROUP_SIZE)
        CLBA_NAME(CL_INVALID_EVENT)
        CLBA_NAME(CL_INVALID_OPERATION)
        CLBA_NAME(CL_INVALID_BUFFER_SIZE)
#undef CLBA_NAME
        case -1001:
            return "CL_PLATFORM_NOT_FOUND_KHR";
        default:
            return "unknown OpenCL error";
    }
}

void check_opencl(cl_int error, const char* call, const std::string& purpose) {
    if (error == CL_SUCCESS) return;
    const bool is_memory = error == CL_MEM_OBJECT_ALLOCATION_FAILURE ||
                           error == CL_OUT_OF_RESOURCES || error == CL_OUT_OF_HOST_MEMORY;
    fail(is_memory ? Status::out_of_memory : Status::device, call, " failed with ",
         opencl_error_name(error), " (", error, ")", purpose.empty() ? "" : " for ", purpose);
}

}  // namespace clba
