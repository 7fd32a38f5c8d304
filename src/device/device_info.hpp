// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <string>
#include <vector>

struct _cl_device_id;
struct _cl_platform_id;

namespace clba {

enum class DeviceType : int { cpu = 1, gpu = 2, accelerator = 3, other = 4 };

struct DeviceInfo {
    int index = 0;  // in the list of all devices of all platforms; -1 if not in it
    DeviceType type = DeviceType::other;
    bool has_double = false;
    bool has_unified_memory = false;
    int compute_units = 0;
    uint64_t global_memory_bytes = 0;
    uint64_t max_allocation_bytes = 0;
    uint64_t local_memory_bytes = 0;
    uint64_t max_work_group_size = 0;
    std::string platform, platform_version, name, vendor, version, driver;
    _cl_device_id* id = nullptr;
};

// What to do where there is no device.
extern const char* const no_device_remedy;

// All devices of all platforms, in the loader's order. Empty without platforms; throws no_device
// without a loader.
std::vector<DeviceInfo> list_devices();

DeviceInfo describe_device(_cl_device_id* id);

// By index (>= 0), else by `name`: an index or a part of a platform's or device's name in any case;
// else, with name empty, the best: GPUs before others, fp64 before not, then compute units. Throws
// no_device naming what was asked for and what there is.
DeviceInfo select_device(int index, const std::string& name);

}  // namespace clba
