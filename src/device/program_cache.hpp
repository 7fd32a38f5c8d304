// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

namespace clba {

// Compiled programs on disk, one file each. A file holds its whole key (library version, source,
// options, platform, device, driver) and a checksum, so that a foreign, truncated or corrupt file
// is a miss and never a wrong program. Any failure to read or write is a miss too.
class ProgramCache {
public:
    // folder "": nothing is kept.
    explicit ProgramCache(std::string folder) : folder_(std::move(folder)) {}

    bool is_enabled() const { return !folder_.empty(); }

    // Empty: not there.
    std::vector<unsigned char> load(const std::string& key) const;
    void store(const std::string& key, const std::vector<unsigned char>& binary) const;

    std::string path(const std::string& key) const;

    // CLBA_CACHE_DIR, else $XDG_CACHE_HOME/clba, else $HOME/.cache/clba, else "".
    static std::string default_folder();

private:
    std::string folder_;
};

}  // namespace clba
