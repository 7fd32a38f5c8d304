// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "base/atomic_file.hpp"

namespace clba {

// Files of one folder that appear together. The folder is made if there is none, and removed again
// if nothing is committed.
class OutputFolder {
public:
    explicit OutputFolder(std::string path);
    ~OutputFolder();
    OutputFolder(const OutputFolder&) = delete;
    OutputFolder& operator=(const OutputFolder&) = delete;

    AtomicFile& add(const std::string& name);
    void add_removal(const std::string& name);  // of a file that may be there
    // All files are on disk under temporary names before the first is renamed.
    void commit();

    std::string path_of(const std::string& name) const { return path_ + "/" + name; }

private:
    std::string path_;
    bool is_new_ = false;
    std::vector<std::unique_ptr<AtomicFile>> files_;
    std::vector<std::string> removals_;
};

// Collects what is written to a file into blocks.
class BlockWriter {
public:
    explicit BlockWriter(AtomicFile& file) : file_(file) {}
    void put(std::string_view bytes) {
        block_ += bytes;
        if (block_.size() >= block_bytes) flush();
    }
    void flush();  // must be called at the end

private:
    static constexpr size_t block_bytes = size_t{1} << 20;
    AtomicFile& file_;
    std::string block_;
};

}  // namespace clba
