// SPDX-License-Identifier: Apache-2.0
#include "io/formats.hpp"

#include <algorithm>
#include <filesystem>
#include <optional>

#include "base/error.hpp"
#include "io/bal.hpp"
#include "io/bundler.hpp"
#include "io/colmap.hpp"
#include "io/convert.hpp"
#include "io/losses.hpp"
#include "io/nvm.hpp"
#include "io/openmvg.hpp"
#include "io/opensfm.hpp"
#include "io/ply.hpp"
#include "io/read_progress.hpp"
#include "io/text_input.hpp"

namespace clba {
namespace {

namespace fs = std::filesystem;

// A text that begins with a number.
bool recognises_bal(const Candidate& candidate) {
    const size_t start = candidate.beginning.find_first_not_of(" \t\r\n\v\f");
    return !candidate.is_folder && start != std::string::npos &&
           std::string_view("+-.0123456789").find(candidate.beginning[start]) !=
               std::string_view::npos;
}

// After white space.
bool begins_with(const Candidate& candidate, std::string_view words) {
    const size_t start = candidate.beginning.find_first_not_of(" \t\r\n");
    return !candidate.is_folder && start != std::string::npos &&
           candidate.beginning.compare(start, words.size(), words) == 0;
}

struct BalDetails final : SourceDetails {
    BalDetails() : SourceDetails("bal", false) {}
    RotationVectors rotations;
};

Reconstruction read_bal_reconstruction(const std::string& path) {
    Reconstruction made;
    const auto details = std::make_shared<BalDetails>();
    made.problem = read_bal(path, &details->rotations);
    made.details = details;
    return made;
}

void write_bal_reconstruction(const Reconstruction& reconstruction, const std::string& path) {
    const Problem& problem = reconstruction.problem;
    const auto* read = dynamic_cast<const BalDetails*>(reconstruction.details.get());
    if (has_snavely_cameras_only(problem))
        write_bal(problem, path, read ? &read->rotations : nullptr);
    else
        write_bal(with_snavely_cameras(problem), path);
}

void write_ply_reconstruction(const Reconstruction& reconstruction, const std::string& path) {
    write_ply(reconstruction.problem, path);
}

constexpr FileFormat formats[] = {
    {Format::bal, "bal", "a text of numbers, plain or compressed", ".bal .txt .gz .bz2", false,
     recognises_bal, read_bal_reconstruction, write_bal_reconstruction, losses_of_bal},
    {Format::colmap_binary, "colmap_binary",
     "a folder with cameras.bin, images.bin and points3D.bin", "", true,
     [](const Candidate& c) { return c.is_folder && has_colmap_binary(c.path); },
     read_colmap_binary, write_colmap_binary, losses_of_colmap},
    {Format::colmap_text, "colmap_text", "a folder with cameras.txt, images.txt and points3D.txt",
     "", true, [](const Candidate& c) { return c.is_folder && has_colmap_text(c.path); },
     read_colmap_text, write_colmap_text, losses_of_colmap},
    {Format::bundler, "bundler", "a text that begins with '# Bundle file v0.3'", ".out", false,
     [](const Candidate& c) { return begins_with(c, "# Bundle file"); }, read_bundler,
     write_bundler, losses_of_bundler},
    {Format::nvm, "nvm", "a text that begins with NVM_V3", ".nvm", false,
     [](const Candidate& c) { return begins_with(c, "NVM_V3"); }, read_nvm, write_nvm,
     losses_of_nvm},
    {Format::openmvg, "openmvg", "a JSON object with sfm_data_version", ".json", false,
     [](const Candidate& c) {
         return begins_with(c, "{") &&
                c.beginning.find("\"sfm_data_version\"") != std::string::npos;
     },
     read_openmvg, write_openmvg, losses_of_openmvg},
    {Format::opensfm, "opensfm",
     "a folder with reconstruction.json and tracks.csv, or a JSON array of reconstructions", "",
     true,
     [](const Candidate& c) { return c.is_folder ? has_opensfm(c.path) : begins_with(c, "["); },
     read_opensfm, write_opensfm, losses_of_opensfm},
    {Format::ply, "ply", "points and camera centres, to look at", ".ply", false, nullptr, nullptr,
     write_ply_reconstruction, nullptr},
};

bool ends_with(std::string_view name, std::string_view ending) {
    return name.size() > ending.size() && name.substr(name.size() - ending.size()) == ending;
}

// Of the endings of a format, separated by spaces.
bool has_ending(const FileFormat& format, std::string_view path) {
    std::string_view rest = format.endings;
    while (!rest.empty()) {
        const size_t end = std::min(rest.find(' '), rest.size());
        if (ends_with(path, rest.substr(0, end))) return true;
        rest.remove_prefix(std::min(end + 1, rest.size()));
    }
    return false;
}

Candidate candidate_of(const std::string& path) {
    std::error_code error;
    Candidate candidate{path, fs::is_directory(path, error), ""};
    if (!candidate.is_folder) {
        constexpr size_t enough = 4096;
        candidate.beginning.resize(enough);
        candidate.beginning.resize(open_input(path)->read(candidate.beginning.data(), enough));
    }
    return candidate;
}

const FileFormat& recognised(const std::string& path) {
    std::error_code error;
    const fs::file_status status = fs::status(path, error);
    // What can be read only once, a pipe, cannot be looked at first.
    if (fs::exists(status) && !fs::is_regular_file(status) && !fs::is_directory(status))
        return *find_format(Format::bal);
    const Candidate candidate = candidate_of(path);
    std::string known;
    for (const FileFormat& format : file_formats()) {
        if (!format.recognises) continue;
        if (format.recognises(candidate)) return format;
        known += text(known.empty() ? "" : "; ", format.name, ": ", format.description);
    }
    fail(Status::format, path,
         candidate.is_folder           ? ": the folder holds"
         : candidate.beginning.empty() ? ": the file is empty and so has"
                                       : ": the file has",
         " none of the formats that are read (", known, ")");
}

int64_t bytes_of(const std::string& path) {
    std::error_code error;
    if (!fs::is_directory(path, error)) {
        const auto bytes = fs::file_size(path, error);
        return error ? 0 : static_cast<int64_t>(bytes);
    }
    int64_t bytes = 0;
    for (const fs::directory_entry& entry : fs::directory_iterator(path, error)) {
        const auto size = entry.file_size(error);
        if (!error) bytes += static_cast<int64_t>(size);
    }
    return bytes;
}

}  // namespace

FileFormats file_formats() {
    return {std::begin(formats), std::end(formats)};
}

const FileFormat* find_format(Format format) {
    for (const FileFormat& row : file_formats())
        if (row.format == format) return &row;
    return nullptr;
}

ReadFile read_reconstruction(const std::string& path, Format format,
                             const std::function<bool(double)>& on_progress) {
    const FileFormat& row = format == Format::automatic ? recognised(path) : *find_format(format);
    require(row.read != nullptr, "format = ", row.name,
            ", but files of this format are only written");
    std::optional<ReadProgress> progress;
    if (on_progress) progress.emplace(bytes_of(path), on_progress);
    return {row.read(path), row.format};
}

Format format_for_output(const std::string& path, Format read_format) {
    std::error_code error;
    const FileFormat* const read = find_format(read_format);
    if (ends_with(path, "/") || fs::is_directory(path, error))
        return read && read->is_folder ? read_format : Format::colmap_binary;
    if (read && has_ending(*read, path)) return read_format;
    for (const FileFormat& format : file_formats())
        if (has_ending(format, path)) return format.format;
    require(
        read != nullptr, path,
        ": its name tells no format, and the problem was not read from a file; name the format");
    return read_format;
}

std::vector<std::string> losses(const Reconstruction& reconstruction, const FileFormat& format) {
    return format.losses ? format.losses(reconstruction) : std::vector<std::string>();
}

}  // namespace clba
