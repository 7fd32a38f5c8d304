// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "io/reconstruction.hpp"

namespace clba {

// The numbers of CLBA_FORMAT_*; src/api checks at compile time that the two agree.
enum class Format : int32_t {
    automatic = 0,
    bal = 1,
    colmap_binary = 2,
    colmap_text = 3,
    bundler = 4,
    nvm = 5,
    openmvg = 6,
    opensfm = 7,
    ply = 8
};

// What is known of an input before it is read.
struct Candidate {
    std::string path;
    bool is_folder = false;
    std::string beginning;  // of a file: its first bytes, decompressed
};

struct FileFormat {
    Format format;
    const char* name;         // as clba_format_name gives it
    const char* description;  // what the user sees where no format was recognised
    const char* endings;      // of names of files in this format, separated by spaces
    bool is_folder;           // what is written is a folder
    bool (*recognises)(const Candidate& candidate);   // nullptr: written only
    Reconstruction (*read)(const std::string& path);  // nullptr: written only
    void (*write)(const Reconstruction& reconstruction, const std::string& path);
    // See losses(); nullptr: a file of this format holds all, or is made only to be looked at.
    std::vector<std::string> (*losses)(const Reconstruction& reconstruction);
};

struct FileFormats {
    const FileFormat *first, *last;
    const FileFormat* begin() const { return first; }
    const FileFormat* end() const { return last; }
};
FileFormats file_formats();
const FileFormat* find_format(Format format);  // nullptr: there is no such format

struct ReadFile {
    Reconstruction reconstruction;
    Format format;
};
// format automatic: by content. on_progress (may be empty): see ReadProgress.
ReadFile read_reconstruction(const std::string& path, Format format,
                             const std::function<bool(double)>& on_progress);

// The format to write to path where none is named: that of the ending, if one has it; of a folder
// or a name that ends in /, a folder's; else the one the problem was read in.
Format format_for_output(const std::string& path, Format read_format);

// What a file of the format would not hold of the reconstruction. An error where the format cannot
// hold it at all.
std::vector<std::string> losses(const Reconstruction& reconstruction, const FileFormat& format);

}  // namespace clba
