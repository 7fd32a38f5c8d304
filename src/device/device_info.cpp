// SPDX-License-Identifier: Apache-2.0
#include "device/device_info.hpp"

#include <algorithm>
#include <charconv>
#include <tuple>

#include "base/error.hpp"
#include "device/opencl.hpp"

namespace clba {
namespace {

template <class Getter>
std::string info_text(const char* call, Getter&& get) {
    size_t bytes = 0;
    check_opencl(get(0, nullptr, &bytes), call);
    std::string value(bytes, '\0');
    check_opencl(get(bytes, value.data(), nullptr), call);
    while (!value.empty() && (value.back() == '\0' || value.back() == ' ')) value.pop_back();
    return value;
}

std::string device_text(cl_device_id id, cl_device_info what) {
    return info_text("clGetDeviceInfo", [&](size_t bytes, void* value, size_t* needed) {
        return opencl().clGetDeviceInfo(id, what, bytes, value, needed);
    });
}

std::string platform_text(cl_platform_id id, cl_platform_info what) {
    return info_text("clGetPlatformInfo", [&](size_t bytes, void* value, size_t* needed) {
        return opencl().clGetPlatformInfo(id, what, bytes, value, needed);
    });
}

template <class Value>
Value device_value(cl_device_id id, cl_device_info what) {
    Value value{};
    check_opencl(opencl().clGetDeviceInfo(id, what, sizeof value, &value, nullptr),
                 "clGetDeviceInfo");
    return value;
}

std::string lower(std::string value) {
    for (char& c : value)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return value;
}

std::string list_text(const std::vector<DeviceInfo>& devices) {
    if (devices.empty()) return text("there is no OpenCL device at all; ", no_device_remedy);
    std::string list = "the devices are";
    for (const DeviceInfo& device : devices)
        list += text(device.index ? ", " : " ", device.index, ": ", device.name, " (",
                     device.platform, ")");
    return list;
}

}  // namespace

const char* const no_device_remedy =
    "install a driver: a GPU vendor's, or pocl-opencl-icd for the CPU (which needs a folder it can "
    "write to: HOME, or POCL_CACHE_DIR)";

std::vector<DeviceInfo> list_devices() {
    OpenCl& cl = opencl();
    cl_uint num_platforms = 0;
    const cl_int error = cl.clGetPlatformIDs(0, nullptr, &num_platforms);
    constexpr cl_int platform_not_found = -1001;  // CL_PLATFORM_NOT_FOUND_KHR, from the loader
    if (error == platform_not_found) return {};
    check_opencl(error, "clGetPlatformIDs");
    std::vector<cl_platform_id> platforms(num_platforms);
    check_opencl(cl.clGetPlatformIDs(num_platforms, platforms.data(), nullptr), "clGetPlatformIDs");
    std::vector<DeviceInfo> devices;
    for (cl_platform_id platform : platforms) {
        cl_uint num_devices = 0;
        const cl_int found =
            cl.clGetDeviceIDs(platform, CL_DEVICE_TYPE_ALL, 0, nullptr, &num_devices);
        if (found == CL_DEVICE_NOT_FOUND || num_devices == 0) continue;
        check_opencl(found, "clGetDeviceIDs");
        std::vector<cl_device_id> ids(num_devices);
        check_opencl(
            cl.clGetDeviceIDs(platform, CL_DEVICE_TYPE_ALL, num_devices, ids.data(), nullptr),
            "clGetDeviceIDs");
        for (cl_device_id id : ids) {
            devices.push_back(describe_device(id));
            devices.back().index = static_cast<int>(devices.size()) - 1;
        }
    }
    return devices;
}

DeviceInfo describe_device(cl_device_id id) {
    DeviceInfo info;
    info.id = id;
    info.index = -1;
    const auto type = device_value<cl_device_type>(id, CL_DEVICE_TYPE);
    info.type = type & CL_DEVICE_TYPE_GPU           ? DeviceType::gpu
                : type & CL_DEVICE_TYPE_CPU         ? DeviceType::cpu
                : type & CL_DEVICE_TYPE_ACCELERATOR ? DeviceType::accelerator
                                                    : DeviceType::other;
    info.has_double = device_value<cl_device_fp_config>(id, CL_DEVICE_DOUBLE_FP_CONFIG) != 0;
    info.has_unified_memory = device_value<cl_bool>(id, CL_DEVICE_HOST_UNIFIED_MEMORY) != 0;
    info.compute_units = static_cast<int>(device_value<cl_uint>(id, CL_DEVICE_MAX_COMPUTE_UNITS));
    info.global_memory_bytes = device_value<cl_ulong>(id, CL_DEVICE_GLOBAL_MEM_SIZE);
    info.max_allocation_bytes = device_value<cl_ulong>(id, CL_DEVICE_MAX_MEM_ALLOC_SIZE);
    info.local_memory_bytes = device_value<cl_ulong>(id, CL_DEVICE_LOCAL_MEM_SIZE);
    info.max_work_group_size = device_value<size_t>(id, CL_DEVICE_MAX_WORK_GROUP_SIZE);
    info.name = device_text(id, CL_DEVICE_NAME);
    info.vendor = device_text(id, CL_DEVICE_VENDOR);
    info.version = device_text(id, CL_DEVICE_VERSION);
    info.driver = device_text(id, CL_DRIVER_VERSION);
    const auto platform = device_value<cl_platform_id>(id, CL_DEVICE_PLATFORM);
    info.platform = platform_text(platform, CL_PLATFORM_NAME);
    info.platform_version = platform_text(platform, CL_PLATFORM_VERSION);
    return info;
}

DeviceInfo select_device(int index, const std::string& name) {
    const std::vector<DeviceInfo> devices = list_devices();
    if (index < 0 && !name.empty()) {
        int parsed = 0;
        const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), parsed);
        if (error == std::errc() && end == name.data() + name.size()) index = parsed;
    }
    if (index >= 0) {
        if (static_cast<size_t>(index) >= devices.size())
            fail(Status::no_device, "there is no device ", index, ": ", list_text(devices));
        return devices[static_cast<size_t>(index)];
    }
    if (!name.empty()) {
        for (const DeviceInfo& device : devices)
            if (lower(device.platform).find(lower(name)) != std::string::npos ||
                lower(device.name).find(lower(name)) != std::string::npos)
                return device;
        fail(Status::no_device, "no platform or device has '", name,
             "' in its name: ", list_text(devices));
    }
    if (devices.empty()) fail(Status::no_device, list_text(devices));
    const auto rank = [](const DeviceInfo& device) {
        return std::make_tuple(device.type == DeviceType::gpu, device.has_double,
                               device.compute_units);
    };
    // The first of equals.
    return *std::max_element(
        devices.begin(), devices.end(),
        [&](const DeviceInfo& a, const DeviceInfo& b) { return rank(a) < rank(b); });
}

}  // namespace clba
