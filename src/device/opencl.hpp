// SPDX-License-Identifier: Apache-2.0
#pragma once
// The OpenCL functions that clba calls, found in the loader library at run time. Only src/device
// includes this file.
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>

#include <string>

namespace clba {

// clang-format off
#define CLBA_OPENCL_FUNCTIONS(F) \
    F(clGetPlatformIDs) F(clGetPlatformInfo) F(clGetDeviceIDs) F(clGetDeviceInfo) \
    F(clCreateContext) F(clRetainContext) F(clReleaseContext) F(clGetContextInfo) \
    F(clCreateCommandQueue) F(clRetainCommandQueue) F(clReleaseCommandQueue) \
    F(clGetCommandQueueInfo) F(clCreateBuffer) F(clReleaseMemObject) F(clEnqueueReadBuffer) \
    F(clEnqueueWriteBuffer) F(clEnqueueFillBuffer) F(clEnqueueCopyBuffer) F(clEnqueueMapBuffer) \
    F(clEnqueueUnmapMemObject) F(clCreateProgramWithSource) F(clCreateProgramWithBinary) \
    F(clBuildProgram) F(clGetProgramInfo) F(clGetProgramBuildInfo) F(clReleaseProgram) \
    F(clCreateKernel) F(clReleaseKernel) F(clSetKernelArg) F(clGetKernelWorkGroupInfo) \
    F(clEnqueueNDRangeKernel) F(clGetEventProfilingInfo) F(clReleaseEvent) F(clFlush) \
    F(clFinish)
// clang-format on

struct OpenCl {
#define CLBA_DECLARE(name) decltype(&::name) name = nullptr;
    CLBA_OPENCL_FUNCTIONS(CLBA_DECLARE)
#undef CLBA_DECLARE
};

// Opens the loader on first use. Throws no_device if there is none, saying what to install.
// The table is mutable for tests that make the n-th call fail.
OpenCl& opencl();

const char* opencl_error_name(cl_int error);

// Throws unless error is CL_SUCCESS: out_of_memory for the codes that mean it, device otherwise.
void check_opencl(cl_int error, const char* call, const std::string& purpose = "");

}  // namespace clba
