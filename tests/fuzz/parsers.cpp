// SPDX-License-Identifier: Apache-2.0
#include "fuzz/parsers.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "base/error.hpp"
#include "fuzz/seeds.hpp"
#include "io/bal.hpp"
#include "io/bal_parallel.hpp"
#include "io/bundler.hpp"
#include "io/colmap.hpp"
#include "io/nvm.hpp"
#include "io/openmvg.hpp"
#include "io/opensfm.hpp"

namespace clba::test {
namespace {

[[noreturn]] void stop(const Parser& parser, const std::string& why) {
    std::fprintf(stderr, "%s: %s\n", parser.name, why.c_str());
    std::abort();
}

template <Reconstruction (*read)(const std::string&),
          void (*write)(const Reconstruction&, const std::string&)>
void read_and_write(const std::string& input, const std::string& output) {
    const Reconstruction reconstruction = read(input);
    try {
        reconstruction.problem.validate();
        write(reconstruction, output);
    } catch (const Error& error) {
        fail(Status::internal, "what was read is refused: ", error.what());
    }
}

void read_and_write_bal(const std::string& input, const std::string& output) {
    BalNumbers numbers;
    const bool is_read = read_bal_in_parallel(input, 64, numbers);
    const Problem problem = read_bal(input);
    const auto is_same = [](const Observation& a, const Observation& b) {
        return a.image == b.image && a.point == b.point && a.x == b.x && a.y == b.y;
    };
    if (is_read && (numbers.points != problem.points ||
                    !std::equal(numbers.observations.begin(), numbers.observations.end(),
                                problem.observations.begin(), problem.observations.end(), is_same)))
        fail(Status::internal, "read in parallel it is another problem");
    try {
        problem.validate();
        write_bal(problem, output);
    } catch (const Error& error) {
        fail(Status::internal, "what was read is refused: ", error.what());
    }
}

// Folders in memory where the system has any, as each input is written to files.
class Folders {
public:
    Folders()
        : root_((std::filesystem::is_directory("/dev/shm")
                     ? std::filesystem::path("/dev/shm")
                     : std::filesystem::temp_directory_path()) /
                text("clba_fuzz_", ::getpid())) {
        std::filesystem::create_directory(root_);
    }
    ~Folders() {
        std::error_code error;
        std::filesystem::remove_all(root_, error);
    }
    // The folder, emptied.
    std::filesystem::path empty(const char* name) const {
        const std::filesystem::path folder = root_ / name;
        std::filesystem::remove_all(folder);
        std::filesystem::create_directory(folder);
        return folder;
    }
    std::filesystem::path path(const char* name) const { return root_ / name; }

private:
    std::filesystem::path root_;
};

std::string path_in(const std::filesystem::path& folder, const Parser& parser) {
    return parser.main.empty() ? folder.string() : (folder / parser.main).string();
}

std::string content(const std::filesystem::path& path) {
    std::ifstream stream(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
}

}  // namespace

const std::string_view separator = "\n%%%%\n";

const std::vector<Parser>& parsers() {
    static const std::vector<Parser> all{
        {"bal", {"problem.txt"}, "problem.txt", false, read_and_write_bal, bal_seeds},
        {"bundler",
         {"bundle.out", "bundle.list.txt"},
         "bundle.out",
         true,
         read_and_write<read_bundler, write_bundler>,
         bundler_seeds},
        {"nvm", {"model.nvm"}, "model.nvm", true, read_and_write<read_nvm, write_nvm>, nvm_seeds},
        {"openmvg",
         {"sfm_data.json"},
         "sfm_data.json",
         true,
         read_and_write<read_openmvg, write_openmvg>,
         openmvg_seeds},
        {"opensfm",
         {"reconstruction.json", "tracks.csv", "ground_control_points.json"},
         "",
         true,
         read_and_write<read_opensfm, write_opensfm>,
         opensfm_seeds},
        {"colmap_text",
         {"cameras.txt", "images.txt", "points3D.txt", "rigs.txt", "frames.txt"},
         "",
         true,
         read_and_write<read_colmap_text, write_colmap_text>,
         colmap_text_seeds},
        {"colmap_binary",
         {"cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"},
         "",
         true,
         read_and_write<read_colmap_binary, write_colmap_binary>,
         colmap_binary_seeds},
    };
    return all;
}

const Parser& parser_named(std::string_view name) {
    for (const Parser& parser : parsers())
        if (parser.name == name) return parser;
    std::fprintf(stderr, "there is no parser %s\n", std::string(name).c_str());
    std::abort();
}

bool accepts(const Parser& parser, std::string_view input) {
    static const Folders folders;
    const std::filesystem::path first = folders.empty("0");
    for (size_t i = 0; i < parser.files.size(); ++i) {
        const size_t end = i + 1 < parser.files.size() ? input.find(separator) : input.size();
        std::ofstream(first / parser.files[i], std::ios::binary) << input.substr(0, end);
        if (end == std::string_view::npos) break;
        input.remove_prefix(std::min(input.size(), end + separator.size()));
    }
    std::filesystem::path from = first;
    for (const char* const next : {"1", "2"}) {
        const std::filesystem::path to = folders.empty(next);
        try {
            parser.read_and_write(path_in(from, parser), path_in(to, parser));
        } catch (const Error& error) {
            const bool is_of_file =
                error.status() == Status::format || error.status() == Status::file;
            if (from == first && is_of_file) return false;
            stop(parser, text("writing and reading again: ", error.what()));
        } catch (const std::exception& error) {
            stop(parser, text("an exception that is no clba::Error: ", error.what()));
        }
        from = to;
    }
    if (parser.is_exact)
        for (const std::string& file : parser.files)
            if (content(folders.path("1") / file) != content(folders.path("2") / file))
                stop(parser, file + " differs when it is written again");
    return true;
}

}  // namespace clba::test
