// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

namespace clba {

// A shared library opened at run time and never closed (drivers keep threads of their own).
class DynamicLibrary {
public:
    // Opens the first of the names that the system's loader finds. When none is found, is_open() is
    // false and error() holds the loader's message on each.
    explicit DynamicLibrary(const std::vector<std::string>& names);
    bool is_open() const { return handle_ != nullptr; }
    const std::string& error() const { return error_; }

    // nullptr: no such symbol.
    template <class Function>
    Function* symbol(const char* name) const {
        return reinterpret_cast<Function*>(address(name));
    }

private:
    void* address(const char* name) const;
    void* handle_ = nullptr;
    std::string error_;
};

// Folder of the library or program that holds this code, with a trailing slash; "" if unknown.
std::string own_folder();

}  // namespace clba
