// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <exception>
#include <string>

#include "cli/commands.hpp"
#include "cli/exit_code.hpp"

namespace {

std::string version_text() {
    const uint32_t version = clba_version();
    return "clba " + std::to_string(version / 10000) + '.' + std::to_string(version / 100 % 100) +
           '.' + std::to_string(version % 100);
}

int report_error(cli::ExitCode code, const char* message) {
    std::fprintf(stderr, "clba: error: %s\n", message);
    return static_cast<int>(code);
}

}  // namespace

int main(int argc, char** argv) try {
    CLI::App program("Bundle adjustment on OpenCL devices", "clba");
    program.set_version_flag("--version", version_text());
    program.require_subcommand(1);
    program.footer(cli::exit_code_help);
    int result = 0;
    cli::add_devices(program);
    cli::add_info(program);
    cli::add_convert(program);
    cli::add_generate(program);
    cli::add_filter(program);
    cli::add_solve(program, result);
    try {
        program.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        if (error.get_exit_code() == 0) return program.exit(error);  // --help, --version
        const std::string message = std::string(error.what()) + "; see clba --help";
        return report_error(cli::ExitCode::usage, message.c_str());
    }
    return result;
} catch (const cli::Failure& failure) {
    return report_error(failure.code(), failure.what());
} catch (const std::exception& error) {
    return report_error(cli::ExitCode::device, error.what());
}
