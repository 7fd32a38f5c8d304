// SPDX-License-Identifier: Apache-2.0
#include "cli/outputs.hpp"

#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>

#include "cli/exit_code.hpp"

namespace cli {
namespace {

namespace fs = std::filesystem;

fs::path folder_of(const fs::path& path) {
    return path.has_parent_path() ? path.parent_path() : fs::path(".");
}

void check_folder(const fs::path& path, const fs::path& folder) {
    std::error_code ignored;
    if (!fs::is_directory(folder, ignored))
        throw Failure(ExitCode::file, path.string() + ": there is no folder " + folder.string() +
                                          " to write to; create it, or name another");
    if (::access(folder.c_str(), W_OK | X_OK) != 0)
        throw Failure(ExitCode::file, path.string() + ": cannot write to folder " +
                                          folder.string() + ": " + std::strerror(errno));
}

void check_no_special_file(const fs::path& path) {
    std::error_code ignored;
    if (fs::exists(path, ignored) && !fs::is_regular_file(path, ignored))
        throw Failure(ExitCode::file,
                      path.string() + ": exists and is not a regular file; name another");
}

void check_output(const fs::path& path) {
    std::error_code ignored;
    if (fs::is_directory(path, ignored) || !path.has_filename())
        throw Failure(ExitCode::file,
                      path.string() + ": this is a folder; name a file in it to write");
    check_no_special_file(path);
    check_folder(path, folder_of(path));
}

void check_file_or_folder(const std::string& path) {
    std::error_code ignored;
    if (fs::is_directory(path, ignored)) return check_folder(path, path);
    // A trailing '/' names a folder to be made.
    const fs::path named = path.substr(0, path.find_last_not_of('/') + 1);
    check_no_special_file(named);
    check_folder(named, folder_of(named));
}

}  // namespace

void check_outputs(const Outputs& outputs, const std::string& problem_input,
                   const std::vector<std::string>& other_inputs) {
    const auto whole = [](const std::string& path) {
        return fs::weakly_canonical(fs::absolute(path));
    };
    std::set<fs::path> inputs, seen;
    for (const std::string& path : other_inputs)
        if (!path.empty()) inputs.insert(whole(path));
    const auto add = [&](const std::string& path) {
        if (inputs.count(whole(path)) > 0)
            throw Failure(ExitCode::usage,
                          path + ": an input has this name and would be lost; name another output");
        if (!seen.insert(whole(path)).second)
            throw Failure(ExitCode::usage,
                          path + ": two outputs have this name; name one of them otherwise");
    };
    if (!outputs.problem.empty()) {
        check_file_or_folder(outputs.problem);
        add(outputs.problem);
    }
    if (!problem_input.empty()) inputs.insert(whole(problem_input));
    for (const std::string& path : outputs.files) {
        if (path.empty()) continue;
        check_output(path);
        add(path);
    }
}

void write_text(const std::string& name, const std::string& text) {
    const std::string path = fs::weakly_canonical(fs::absolute(name)).string();  // links followed
    const std::string temporary = path + ".tmp." + std::to_string(::getpid());
    std::ofstream file(temporary, std::ios::binary | std::ios::trunc);
    file << text;
    file.close();
    std::error_code error;
    if (file) fs::rename(temporary, path, error);
    if (!file || error) {
        const std::string reason = error ? error.message() : std::strerror(errno);
        fs::remove(temporary, error);
        throw Failure(ExitCode::file, path + ": cannot be written: " + reason);
    }
}

}  // namespace cli
