// SPDX-License-Identifier: Apache-2.0
#include "device/queue.hpp"

#include "base/error.hpp"
#include "device/opencl.hpp"

namespace clba {

Queue::Queue(std::shared_ptr<Context> context)
    : context_(std::move(context)), memory_(std::make_shared<MemoryAccount>()) {
    OpenCl& cl = opencl();
    cl_int error = CL_SUCCESS;
    if (context_->caller_queue()) {
        check_opencl(cl.clRetainCommandQueue(context_->caller_queue()), "clRetainCommandQueue");
        queue_ = context_->caller_queue();
    } else {
        queue_ = cl.clCreateCommandQueue(context_->cl_context(), context_->device().id,
                                         CL_QUEUE_PROFILING_ENABLE, &error);
        check_opencl(error, "clCreateCommandQueue", context_->device().name);
    }
    cl_command_queue_properties properties = 0;
    cl.clGetCommandQueueInfo(queue_, CL_QUEUE_PROPERTIES, sizeof properties, &properties, nullptr);
    has_profiling_ = properties & CL_QUEUE_PROFILING_ENABLE;
    if (properties & CL_QUEUE_OUT_OF_ORDER_EXEC_MODE_ENABLE) {
        cl.clReleaseCommandQueue(queue_);
        fail(Status::invalid_argument,
             "cl_command_queue runs out of order, but clba needs an in-order queue");
    }
}

Queue::~Queue() {
    OpenCl& cl = opencl();
    cl.clFinish(queue_);
    for (const auto& [step, event] : events_) cl.clReleaseEvent(event);
    for (const auto& [key, kernel] : kernels_) cl.clReleaseKernel(kernel.handle);
    cl.clReleaseCommandQueue(queue_);
}

Kernel& Queue::kernel(const std::string& path, const std::string& name, const std::string& defines,
                      const std::string& camera_model_path) {
    const std::string key = name + ' ' + defines + ' ' + camera_model_path;
    const auto found = kernels_.find(key);
    if (found != kernels_.end()) return found->second;
    std::string options = text("-cl-std=CL1.2 -DLANE_LOOP=", tuning().lane_loop ? 1 : 0,
                               " -DRUN_MULTIPLE=", tuning().lanes);
    if (!tuning().vectorize) options += " -DNO_VECTORIZE";
    if (!defines.empty()) options += ' ' + defines;
    _cl_program* program = context_->program(path, camera_model_path, options);
    // Its place comes first: if there is no memory for that, there is no kernel to release either.
    const auto place = kernels_.emplace(key, Kernel{nullptr, name}).first;
    cl_int error = CL_SUCCESS;
    place->second.handle = opencl().clCreateKernel(program, name.c_str(), &error);
    if (error != CL_SUCCESS) kernels_.erase(place);
    check_opencl(error, "clCreateKernel", name);
    return place->second;
}

void Queue::set_bytes(Kernel& kernel, unsigned index, size_t bytes, const void* value) {
    const cl_int error = opencl().clSetKernelArg(kernel.handle, index, bytes, value);
    if (error != CL_SUCCESS)
        check_opencl(error, "clSetKernelArg", text("argument ", index, " of ", kernel.name));
}

void Queue::set_argument(Kernel& kernel, unsigned index, const Buffer& buffer) {
    const cl_mem handle = buffer.handle();
    set_bytes(kernel, index, sizeof handle, &handle);
}

void Queue::set_argument(Kernel& kernel, unsigned index, const Buffer* buffer) {
    const cl_mem handle = buffer ? buffer->handle() : nullptr;
    set_bytes(kernel, index, sizeof handle, &handle);
}

void Queue::set_argument(Kernel& kernel, unsigned index, const Scratch& scratch) {
    set_bytes(kernel, index, scratch.bytes, nullptr);
}

void Queue::set_argument(Kernel& kernel, unsigned index, int32_t value) {
    set_bytes(kernel, index, sizeof value, &value);
}

void Queue::set_argument(Kernel& kernel, unsigned index, double value) {
    const auto rounded = static_cast<float>(value);
    if (passes_floats_)
        set_bytes(kernel, index, sizeof rounded, &rounded);
    else
        set_bytes(kernel, index, sizeof value, &value);
}

void Queue::enqueue(Step step, Kernel& kernel, int64_t groups) {
    const auto local = static_cast<size_t>(tuning().work_group_size);
    const size_t global = static_cast<size_t>(groups) * local;
    constexpr size_t many_events = 4096;
    if (has_profiling_) events_.reserve(many_events);
    cl_event event = nullptr;
    const cl_int error =
        opencl().clEnqueueNDRangeKernel(queue_, kernel.handle, 1, nullptr, &global, &local, 0,
                                        nullptr, has_profiling_ ? &event : nullptr);
    if (error != CL_SUCCESS) check_opencl(error, "clEnqueueNDRangeKernel", kernel.name);
    if (event) events_.emplace_back(step, event);
    if (events_.size() >= many_events) finish();
}

void Queue::finish() {
    check_opencl(opencl().clFinish(queue_), "clFinish");
    collect_events();
}

void Queue::collect_events() {
    OpenCl& cl = opencl();
    for (const auto& [step, event] : events_) {
        cl_ulong start = 0, end = 0;
        if (cl.clGetEventProfilingInfo(event, CL_PROFILING_COMMAND_START, sizeof start, &start,
                                       nullptr) == CL_SUCCESS &&
            cl.clGetEventProfilingInfo(event, CL_PROFILING_COMMAND_END, sizeof end, &end,
                                       nullptr) == CL_SUCCESS)
            step_seconds_[static_cast<size_t>(step)] += 1e-9 * static_cast<double>(end - start);
        cl.clReleaseEvent(event);
    }
    events_.clear();
}

std::array<double, num_steps> Queue::step_seconds() {
    finish();
    return step_seconds_;
}

void Queue::reset_step_seconds() {
    finish();
    step_seconds_.fill(0);
}

}  // namespace clba
