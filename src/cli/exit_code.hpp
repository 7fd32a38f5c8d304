// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <stdexcept>
#include <string>

#include "clba/clba.h"

namespace cli {

// What `clba` returns to its caller; scripts rely on these numbers.
enum class ExitCode : int {
    ok = 0,
    usage = 2,         // bad arguments
    not_solved = 3,    // the solver found no usable step
    file = 4,          // a file cannot be read or written, or breaks its format
    no_device = 5,     // no device, or the plug-in for direct_schur is missing
    device = 6,        // memory, kernel build, any other device error, or a bug
    interrupted = 130  // stopped by Ctrl-C; outputs are written
};

extern const char* const exit_code_help;

class Failure : public std::runtime_error {
public:
    Failure(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ExitCode code() const { return code_; }

private:
    ExitCode code_;
};

// Throws a Failure with clba_last_error() unless status is CLBA_OK.
void check(clba_status status);

}  // namespace cli
