// SPDX-License-Identifier: Apache-2.0
#include "cli/interrupt.hpp"

#include <signal.h>
#include <unistd.h>

#include <atomic>

namespace cli {
namespace {

volatile sig_atomic_t interrupt_seen = 0;
std::atomic<clba_cancellation*> requested_on_interrupt{nullptr};
static_assert(decltype(requested_on_interrupt)::is_always_lock_free);

void on_interrupt(int) {
    interrupt_seen = 1;
    clba_cancellation_request(requested_on_interrupt);
    constexpr char message[] = "\nclba: stopping; Ctrl-C again ends at once\n";
    const ssize_t written = ::write(STDERR_FILENO, message, sizeof message - 1);
    (void)written;  // nothing can be done about it here
}

}  // namespace

InterruptGuard::InterruptGuard() {
    clba_cancellation* cancellation = nullptr;
    check(clba_cancellation_create(&cancellation));
    cancellation_.reset(cancellation);
    requested_on_interrupt = cancellation;
    struct sigaction action = {};
    action.sa_handler = on_interrupt;
    action.sa_flags = SA_RESTART | static_cast<int>(SA_RESETHAND);
    ::sigaction(SIGINT, &action, nullptr);
}

InterruptGuard::~InterruptGuard() {
    ::signal(SIGINT, SIG_DFL);
    requested_on_interrupt = nullptr;
}

bool interrupted() {
    return interrupt_seen != 0;
}

}  // namespace cli
