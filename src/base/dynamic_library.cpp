// SPDX-License-Identifier: Apache-2.0
#include "base/dynamic_library.hpp"

#include <dlfcn.h>

namespace clba {

DynamicLibrary::DynamicLibrary(const std::vector<std::string>& names) {
    for (const std::string& name : names) {
        handle_ = ::dlopen(name.c_str(), RTLD_NOW | RTLD_LOCAL);
        if (handle_) return;
        if (!error_.empty()) error_ += "; ";
        error_ += ::dlerror();
    }
}

void* DynamicLibrary::address(const char* name) const {
    return handle_ ? ::dlsym(handle_, name) : nullptr;
}

std::string own_folder() {
    Dl_info info;
    if (!::dladdr(reinterpret_cast<void*>(&own_folder), &info) || !info.dli_fname) return "";
    const std::string path = info.dli_fname;
    const size_t slash = path.rfind('/');
    return slash == std::string::npos ? "" : path.substr(0, slash + 1);
}

}  // namespace clba
