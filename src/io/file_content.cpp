// SPDX-License-Identifier: Apache-2.0
#include "io/file_content.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "base/error.hpp"

namespace clba {

FileContent::FileContent(const std::string& path) : path_(path) {
    const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "rb"),
                                                               std::fclose);
    struct stat status {};
    if (!file || ::fstat(::fileno(file.get()), &status) != 0)
        fail(Status::file, "cannot open ", path, ": ", std::strerror(errno));
    if (!S_ISREG(status.st_mode))
        fail(Status::file, "cannot read ", path, ": it is not a regular file");
    size_ = static_cast<size_t>(status.st_size);
    bytes_.reset(new char[size_]);  // not set to 0, as make_unique would
    std::setvbuf(file.get(), nullptr, _IONBF, 0);
    if (std::fread(bytes_.get(), 1, size_, file.get()) != size_)
        fail(Status::file, "cannot read ", path, ": ",
             std::ferror(file.get()) ? std::strerror(errno) : "it became shorter meanwhile");
}

size_t FileContent::line_at(const char* position) const {
    return static_cast<size_t>(
        1 + std::count(bytes_.get(), const_cast<char*>(bytes_.get()) + (position - bytes_.get()),
                       '\n'));
}

}  // namespace clba
