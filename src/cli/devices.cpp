// SPDX-License-Identifier: Apache-2.0
#include <cstdio>

#include "cli/commands.hpp"
#include "cli/handles.hpp"

namespace cli {
namespace {

const char* type_name(int32_t type) {
    switch (type) {
        case CLBA_DEVICE_CPU:
            return "CPU";
        case CLBA_DEVICE_GPU:
            return "GPU";
        case CLBA_DEVICE_ACCELERATOR:
            return "accelerator";
        default:
            return "other";
    }
}

void print_device(const clba_device_info& device) {
    constexpr double gib = 1024.0 * 1024.0 * 1024.0;
    std::printf("%d: %s\n", device.index, device.name);
    std::printf("   platform       %s\n", device.platform);
    std::printf("   vendor         %s\n", device.vendor);
    std::printf("   version        %s, driver %s\n", device.version, device.driver);
    std::printf("   type           %s, %d compute units\n", type_name(device.type),
                device.compute_units);
    std::printf("   memory         %.2f GiB%s, one buffer at most %.2f GiB\n",
                static_cast<double>(device.global_memory_bytes) / gib,
                device.has_unified_memory ? " shared with the host" : "",
                static_cast<double>(device.max_allocation_bytes) / gib);
    std::printf("   fp64           %s\n", device.has_double ? "yes" : "no, cannot be used");
}

void list_devices() {
    int32_t num_devices = 0;
    check(clba_num_devices(&num_devices));
    if (num_devices == 0) throw Failure(ExitCode::no_device, clba_last_error());
    for (int32_t index = 0; index < num_devices; ++index) {
        clba_device_info device = {};
        device.struct_size = sizeof device;
        check(clba_get_device(index, &device));
        print_device(device);
    }
}

}  // namespace

void add_devices(CLI::App& program) {
    program.add_subcommand("devices", "List the OpenCL devices")->callback(list_devices);
}

}  // namespace cli
