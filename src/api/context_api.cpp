// SPDX-License-Identifier: Apache-2.0
// Status, devices and contexts.
#include <algorithm>
#include <cstdlib>

#include "api/handles.hpp"
#include "device/program_cache.hpp"

namespace clba {
namespace {

thread_local std::string last_error;

clba_device_info public_info(const DeviceInfo& device) {
    clba_device_info info{};
    info.struct_size = sizeof info;
    info.index = device.index;
    info.type = static_cast<int32_t>(device.type);
    info.has_double = device.has_double;
    info.compute_units = device.compute_units;
    info.has_unified_memory = device.has_unified_memory;
    info.global_memory_bytes = device.global_memory_bytes;
    info.max_allocation_bytes = device.max_allocation_bytes;
    info.local_memory_bytes = device.local_memory_bytes;
    copy_text(device.platform, info.platform);
    copy_text(device.name, info.name);
    copy_text(device.vendor, info.vendor);
    copy_text(device.version, info.version);
    copy_text(device.driver, info.driver);
    return info;
}

clba_context_options default_context_options() {
    clba_context_options options{};
    options.struct_size = sizeof options;
    options.device_index = -1;
    return options;
}

#define CLBA_SAME_STATUS(name, number)                        \
    static_assert(static_cast<int>(Status::name) == (number), \
                  "Status must have the numbers of clba_status");
CLBA_SAME_STATUS(invalid_argument, CLBA_ERROR_INVALID_ARGUMENT)
CLBA_SAME_STATUS(out_of_memory, CLBA_ERROR_OUT_OF_MEMORY)
CLBA_SAME_STATUS(no_device, CLBA_ERROR_NO_DEVICE)
CLBA_SAME_STATUS(kernel_build, CLBA_ERROR_KERNEL_BUILD)
CLBA_SAME_STATUS(device, CLBA_ERROR_DEVICE)
CLBA_SAME_STATUS(internal, CLBA_ERROR_INTERNAL)
CLBA_SAME_STATUS(file, CLBA_ERROR_FILE)
CLBA_SAME_STATUS(format, CLBA_ERROR_FORMAT)
CLBA_SAME_STATUS(no_plugin, CLBA_ERROR_NO_PLUGIN)
CLBA_SAME_STATUS(cancelled, CLBA_ERROR_CANCELLED)
#undef CLBA_SAME_STATUS

}  // namespace

void set_last_error(std::string_view message, std::string_view more) noexcept {
    try {
        last_error.assign(message).append(more);
    } catch (...) {
        last_error.clear();
    }
}

}  // namespace clba

using namespace clba;

uint32_t clba_version(void) {
    return CLBA_VERSION;
}

const char* clba_status_string(clba_status status) {
    switch (status) {
        case CLBA_OK:
            return "ok";
        case CLBA_ERROR_INVALID_ARGUMENT:
            return "invalid argument";
        case CLBA_ERROR_OUT_OF_MEMORY:
            return "out of memory";
        case CLBA_ERROR_NO_DEVICE:
            return "no device";
        case CLBA_ERROR_KERNEL_BUILD:
            return "kernel build failed";
        case CLBA_ERROR_DEVICE:
            return "device error";
        case CLBA_ERROR_INTERNAL:
            return "internal error";
        case CLBA_ERROR_FILE:
            return "file error";
        case CLBA_ERROR_FORMAT:
            return "format error";
        case CLBA_ERROR_NO_PLUGIN:
            return "no plug-in";
        case CLBA_ERROR_CANCELLED:
            return "cancelled";
        default:
            return "unknown status";
    }
}

const char* clba_last_error(void) {
    return last_error.c_str();
}

clba_status clba_num_devices(int32_t* num_devices) {
    std::string missing;
    const clba_status status = guarded([&] {
        require_pointer(num_devices, "num_devices");
        try {
            *num_devices = static_cast<int32_t>(list_devices().size());
            if (*num_devices == 0)
                missing = text("the OpenCL loader lists no device; ", no_device_remedy);
        } catch (const Error& error) {
            if (error.status() != Status::no_device) throw;
            *num_devices = 0;
            missing = error.what();
        }
    });
    if (!missing.empty()) set_last_error(missing);
    return status;
}

clba_status clba_get_device(int32_t index, clba_device_info* info) {
    return guarded([&] {
        require(index >= 0, "index = ", index, ", but a device's index is at least 0");
        copy_out(public_info(select_device(index, "")), info, "info");
    });
}

clba_status clba_context_options_init(clba_context_options* options, size_t struct_size) {
    return guarded(
        [&] { init_struct(options, struct_size, default_context_options(), "options"); });
}

clba_status clba_context_create(const clba_context_options* options, clba_context** context) {
    if (context) *context = nullptr;
    return guarded([&] {
        require_pointer(context, "context");
        const clba_context_options given = copied_in(options, default_context_options(), "options");
        require(given.device_index >= -1, "device_index = ", given.device_index,
                ", but it is an index of at least 0, or -1");
        ContextOptions internal;
        internal.device_index = given.device_index;
        if (given.device) {
            internal.device = given.device;
        } else if (const char* named = std::getenv("CLBA_DEVICE");
                   named && given.device_index < 0) {
            internal.device = named;
        }
        internal.cache_folder = given.cache_dir ? given.cache_dir : ProgramCache::default_folder();
        internal.cache_is_required = given.cache_dir || std::getenv("CLBA_CACHE_DIR");
        internal.max_allocation_bytes = given.max_allocation_bytes;
        internal.cl_context = static_cast<_cl_context*>(given.cl_context);
        internal.cl_device = static_cast<_cl_device_id*>(given.cl_device_id);
        internal.cl_queue = static_cast<_cl_command_queue*>(given.cl_command_queue);
        auto made = std::make_unique<clba_context>();
        made->context = std::make_shared<Context>(internal);
        *context = made.release();
    });
}

clba_status clba_context_retain(clba_context* context) {
    return guarded([&] {
        require_pointer(context, "context");
        ++context->references;
    });
}

void clba_context_release(clba_context* context) {
    if (context && --context->references == 0) delete context;
}

clba_status clba_context_get_device(const clba_context* context, clba_device_info* info) {
    return guarded([&] {
        require_pointer(context, "context");
        copy_out(public_info(context->context->device()), info, "info");
    });
}
