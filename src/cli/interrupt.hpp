// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace cli {

// While one exists, the first Ctrl-C only sets interrupted(); a second one ends the program.
class InterruptGuard {
public:
    InterruptGuard();
    ~InterruptGuard();
    InterruptGuard(const InterruptGuard&) = delete;
    InterruptGuard& operator=(const InterruptGuard&) = delete;
};

bool interrupted();

}  // namespace cli
