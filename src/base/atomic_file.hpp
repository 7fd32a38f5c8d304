// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdio>
#include <string>
#include <string_view>

namespace clba {

// A file that appears under its name only when it is complete: written to a temporary beside it
// (unique to the process and the object) and renamed by commit(). Destroyed before that, the
// temporary is removed and whatever stood under the name stays. A link is followed, so that its
// target is replaced; what exists and is no regular file (a device, a pipe, a folder) is refused.
// Errors are Status::file and give the path and the system's reason.
class AtomicFile {
public:
    explicit AtomicFile(std::string path);
    ~AtomicFile();
    AtomicFile(const AtomicFile&) = delete;
    AtomicFile& operator=(const AtomicFile&) = delete;

    void write(std::string_view bytes);
    void finish();  // flushes to disk and closes: what can fail has been done, but not the renaming
    void commit();  // finishes and renames

private:
    std::string path_;
    std::string temporary_;
    std::FILE* file_ = nullptr;  // null: finished
    bool has_temporary_ = false;
};

}  // namespace clba
