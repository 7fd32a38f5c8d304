// SPDX-License-Identifier: Apache-2.0
#include "device/buffer.hpp"

#include <algorithm>

#include "base/error.hpp"
#include "device/opencl.hpp"
#include "device/queue.hpp"

namespace clba {

Buffer::Buffer(Queue& queue, uint64_t bytes, const std::string& label)
    : queue_(&queue), bytes_(bytes), memory_(queue.memory_account()) {
    const Context& context = queue.context();
    if (bytes > context.max_allocation_bytes())
        fail(Status::out_of_memory, label, " wants ", bytes, " bytes, but the largest buffer of ",
             context.device().name, " is ", context.max_allocation_bytes(), " bytes");
    // OpenCL knows no empty buffers.
    const uint64_t allocated = std::max<uint64_t>(bytes, sizeof(double));
    // Memory that both sides can reach, so that mapping it copies nothing.
    const cl_mem_flags flags =
        CL_MEM_READ_WRITE | (context.device().has_unified_memory ? CL_MEM_ALLOC_HOST_PTR : 0);
    cl_int error = CL_SUCCESS;
    handle_ = opencl().clCreateBuffer(context.cl_context(), flags, allocated, nullptr, &error);
    if (error != CL_SUCCESS)
        fail(Status::out_of_memory, "no device memory for ", label, ": wanted ", bytes,
             " bytes beside the ", memory_->current_bytes, " in use; ", context.device().name,
             " has ", context.device().global_memory_bytes,
             " bytes (clCreateBuffer: ", opencl_error_name(error), ")");
    memory_->current_bytes += bytes_;
    memory_->peak_bytes = std::max(memory_->peak_bytes, memory_->current_bytes);
}

Buffer::~Buffer() {
    if (!handle_) return;
    opencl().clReleaseMemObject(handle_);
    memory_->current_bytes -= bytes_;
}

void Buffer::fill_zero() {
    if (bytes_ == 0) return;
    const cl_uchar zero = 0;
    check_opencl(opencl().clEnqueueFillBuffer(queue_->handle(), handle_, &zero, sizeof zero, 0,
                                              bytes_, 0, nullptr, nullptr),
                 "clEnqueueFillBuffer");
}

void Buffer::copy_from(const Buffer& source) {
    if (bytes_ == 0) return;
    check_opencl(opencl().clEnqueueCopyBuffer(queue_->handle(), source.handle_, handle_, 0, 0,
                                              bytes_, 0, nullptr, nullptr),
                 "clEnqueueCopyBuffer");
}

void Buffer::write(const void* data, uint64_t bytes) {
    if (bytes == 0) return;
    check_opencl(opencl().clEnqueueWriteBuffer(queue_->handle(), handle_, CL_TRUE, 0, bytes, data,
                                               0, nullptr, nullptr),
                 "clEnqueueWriteBuffer");
}

void Buffer::read(void* data, uint64_t bytes) const {
    if (bytes == 0) return;
    check_opencl(opencl().clEnqueueReadBuffer(queue_->handle(), handle_, CL_TRUE, 0, bytes, data, 0,
                                              nullptr, nullptr),
                 "clEnqueueReadBuffer");
}

void* Buffer::map(Access access) const {
    cl_int error = CL_SUCCESS;
    const cl_map_flags flags = access == Access::read    ? CL_MAP_READ
                               : access == Access::write ? CL_MAP_WRITE_INVALIDATE_REGION
                                                         : CL_MAP_READ | CL_MAP_WRITE;
    void* address =
        opencl().clEnqueueMapBuffer(queue_->handle(), handle_, CL_TRUE, flags, 0,
                                    std::max<uint64_t>(bytes_, 1), 0, nullptr, nullptr, &error);
    check_opencl(error, "clEnqueueMapBuffer");
    return address;
}

void Buffer::unmap(void* address) const {
    // Called from a destructor: an error here shows at the next call on the queue.
    opencl().clEnqueueUnmapMemObject(queue_->handle(), handle_, address, 0, nullptr, nullptr);
}

}  // namespace clba
