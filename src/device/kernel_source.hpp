// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

namespace clba {

// The files of kernels/, embedded at build time.
struct EmbeddedKernel {
    const char* path;  // below kernels/
    const char* source;
};
extern const EmbeddedKernel embedded_kernels[];
extern const int num_embedded_kernels;

// The source of kernels/<path> with its includes put in once each, behind #line directives that
// name the files. camera_model.clh is replaced by the given file of kernels/, unless that is empty.
std::string kernel_source(const std::string& path, const std::string& camera_model_path);

}  // namespace clba
