// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "api/handles.hpp"
#include "optimizer/solve.hpp"

namespace clba {

// A problem that has been used leaves its mirror behind for the next call, unless that call failed.
template <class Body>
void with_mirror(clba_problem* handle, clba_context* context, Precision precision, Body&& body) {
    try {
        body(mirror(handle->problem, context->context, precision, handle->mirror));
    } catch (...) {
        handle->mirror.reset();
        throw;
    }
}

}  // namespace clba
