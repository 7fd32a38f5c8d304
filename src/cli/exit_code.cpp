// SPDX-License-Identifier: Apache-2.0
#include "cli/exit_code.hpp"

namespace cli {
namespace {

ExitCode exit_code_of(clba_status status) {
    switch (status) {
        case CLBA_ERROR_INVALID_ARGUMENT:
            return ExitCode::usage;
        case CLBA_ERROR_FILE:
        case CLBA_ERROR_FORMAT:
            return ExitCode::file;
        case CLBA_ERROR_NO_DEVICE:
        case CLBA_ERROR_NO_PLUGIN:
            return ExitCode::no_device;
        default:
            return ExitCode::device;
    }
}

}  // namespace

const char* const exit_code_help =
    "Exit codes:\n"
    "  0    done; a solve converged or met a limit on iterations or time\n"
    "  2    bad arguments\n"
    "  3    the solver found no usable step; outputs hold the best state\n"
    "  4    a file cannot be read or written, or breaks its format\n"
    "  5    no device, or no plug-in clba_cholmod for direct_schur\n"
    "  6    out of memory, kernel build or other device error, internal error\n"
    "  130  stopped by Ctrl-C; outputs hold the best state\n";

void check(clba_status status) {
    if (status != CLBA_OK) throw Failure(exit_code_of(status), clba_last_error());
}

}  // namespace cli
