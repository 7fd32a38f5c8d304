// SPDX-License-Identifier: Apache-2.0
#include "base/atomic_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "base/error.hpp"

namespace clba {

AtomicFile::AtomicFile(std::string path) : path_(std::move(path)) {
    std::error_code error;
    const std::filesystem::file_status status = std::filesystem::status(path_, error);
    if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
        fail(Status::file, "cannot write ", path_,
             ": it exists and is not a regular file; name another");
    if (std::filesystem::is_symlink(std::filesystem::symlink_status(path_, error)))
        path_ = std::filesystem::weakly_canonical(path_).string();
    static std::atomic<unsigned> counter{0};
    temporary_ = text(path_, ".", ::getpid(), ".", counter++, ".tmp");
    const int descriptor =
        ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor >= 0) file_ = ::fdopen(descriptor, "wb");
    if (!file_) {
        const int reason = errno;
        if (descriptor >= 0) {
            ::close(descriptor);
            ::unlink(temporary_.c_str());
        }
        fail(Status::file, "cannot write ", path_, ": ", std::strerror(reason),
             "; its folder must exist and be writable");
    }
    has_temporary_ = true;
}

AtomicFile::~AtomicFile() {
    if (file_) std::fclose(file_);
    if (has_temporary_) ::unlink(temporary_.c_str());
}

void AtomicFile::write(std::string_view bytes) {
    if (std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size())
        fail(Status::file, "cannot write ", path_, ": ", std::strerror(errno));
}

void AtomicFile::finish() {
    if (!file_) return;
    if (std::fflush(file_) != 0 || ::fsync(::fileno(file_)) != 0)
        fail(Status::file, "cannot write ", path_, ": ", std::strerror(errno));
    std::fclose(file_);
    file_ = nullptr;
}

void AtomicFile::commit() {
    finish();
    if (std::rename(temporary_.c_str(), path_.c_str()) != 0)
        fail(Status::file, "cannot write ", path_, ": ", std::strerror(errno));
    has_temporary_ = false;
}

}  // namespace clba
