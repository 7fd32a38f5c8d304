// SPDX-License-Identifier: Apache-2.0
#include "cli/files.hpp"

#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <sstream>

#include "cli/options.hpp"

namespace cli {
namespace {

using Clock = std::chrono::steady_clock;

class ReadProgress {
public:
    ReadProgress() : is_terminal_(::isatty(STDERR_FILENO)) {}
    ~ReadProgress() {
        if (is_shown_) std::fputs("\r\033[K", stderr);
    }
    ReadProgress(const ReadProgress&) = delete;
    ReadProgress& operator=(const ReadProgress&) = delete;

    static int32_t on_progress(double fraction, void* user_data) {
        static_cast<ReadProgress*>(user_data)->show(fraction);
        return 0;
    }

private:
    void show(double fraction) {
        constexpr std::chrono::milliseconds patience(500);
        if (!is_terminal_ || Clock::now() - start_ < patience) return;
        std::fprintf(stderr, "\rreading: %.0f %%\033[K", 100 * fraction);
        std::fflush(stderr);
        is_shown_ = true;
    }

    const bool is_terminal_;
    bool is_shown_ = false;
    const Clock::time_point start_ = Clock::now();
};

clba_write_options options_of(const Output& output) {
    clba_write_options options = {};
    check(clba_write_options_init(&options, sizeof options));
    options.format = output.format;
    options.accept_loss = output.accept_loss;
    return options;
}

}  // namespace

const char* const problem_help =
    "problem: a file or folder of BAL, COLMAP, Bundler, VisualSFM, OpenMVG or OpenSfM, told by its "
    "content";

Problem read_problem(const std::string& path, bool quiet) {
    clba_problem* made = nullptr;
    {
        ReadProgress progress;
        clba_read_options options = {};
        check(clba_read_options_init(&options, sizeof options));
        options.on_progress = ReadProgress::on_progress;
        options.user_data = &progress;
        check(clba_problem_read(path.c_str(), &options, &made));
    }
    Problem problem(made);
    std::istringstream notices(clba_problem_notices(made));
    for (std::string notice; !quiet && std::getline(notices, notice);)
        std::fprintf(stderr, "clba: note: %s: %s\n", path.c_str(), notice.c_str());
    return problem;
}

void add_output_format(CLI::App& command, const std::string& name, Output& output) {
    add_choice(command, name, output.format, clba_format_name, "format of the output");
    command.add_flag("--accept-loss", output.accept_loss,
                     "leave out what the output's format does not hold");
}

void check_write(const clba_problem* problem, const Output& output) {
    const clba_write_options options = options_of(output);
    check(clba_problem_check_write(problem, output.path.c_str(), &options));
}

void write_problem(const clba_problem* problem, const Output& output) {
    const clba_write_options options = options_of(output);
    check(clba_problem_write(problem, output.path.c_str(), &options));
}

}  // namespace cli
