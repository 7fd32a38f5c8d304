// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "cli/handles.hpp"

namespace cli {

// While one exists, the first Ctrl-C only sets interrupted() and requests the cancellation; a
// second one ends the program.
class InterruptGuard {
public:
    InterruptGuard();
    clba_cancellation* cancellation() const { return cancellation_.get(); }
    ~InterruptGuard();
    InterruptGuard(const InterruptGuard&) = delete;
    InterruptGuard& operator=(const InterruptGuard&) = delete;

private:
    Cancellation cancellation_;
};

bool interrupted();

}  // namespace cli
