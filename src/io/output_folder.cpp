// SPDX-License-Identifier: Apache-2.0
#include "io/output_folder.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>

#include "base/error.hpp"

namespace clba {

OutputFolder::OutputFolder(std::string path) : path_(std::move(path)) {
    while (path_.size() > 1 && path_.back() == '/') path_.pop_back();
    std::error_code error;
    if (std::filesystem::is_directory(path_, error)) return;
    if (::mkdir(path_.c_str(), 0777) != 0)
        fail(Status::file, "cannot make the folder ", path_, ": ", std::strerror(errno),
             "; name one that exists, or a new one in a folder that can be written");
    is_new_ = true;
}

OutputFolder::~OutputFolder() {
    files_.clear();
    if (is_new_) ::rmdir(path_.c_str());
}

AtomicFile& OutputFolder::add(const std::string& name) {
    files_.push_back(std::make_unique<AtomicFile>(path_of(name)));
    return *files_.back();
}

void OutputFolder::add_removal(const std::string& name) {
    removals_.push_back(path_of(name));
}

void OutputFolder::commit() {
    for (const auto& file : files_) file->finish();
    for (const auto& file : files_) {
        file->commit();
        is_new_ = false;
    }
    for (const std::string& path : removals_)
        if (::unlink(path.c_str()) != 0 && errno != ENOENT)
            fail(Status::file, "cannot remove ", path,
                 ", which does not belong to what was written: ", std::strerror(errno));
}

void BlockWriter::flush() {
    file_.write(block_);
    block_.clear();
}

}  // namespace clba
