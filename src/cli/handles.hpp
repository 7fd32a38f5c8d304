// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <memory>

#include "clba/clba.h"
#include "cli/exit_code.hpp"

namespace cli {

struct Release {
    void operator()(clba_context* context) const { clba_context_release(context); }
    void operator()(clba_problem* problem) const { clba_problem_release(problem); }
    void operator()(clba_result* result) const { clba_result_release(result); }
    void operator()(clba_covariance* covariance) const { clba_covariance_release(covariance); }
    void operator()(clba_cancellation* cancellation) const {
        clba_cancellation_release(cancellation);
    }
};
using Context = std::unique_ptr<clba_context, Release>;
using Problem = std::unique_ptr<clba_problem, Release>;
using Result = std::unique_ptr<clba_result, Release>;
using Covariance = std::unique_ptr<clba_covariance, Release>;
using Cancellation = std::unique_ptr<clba_cancellation, Release>;

inline clba_problem_info info_of(const clba_problem* problem) {
    clba_problem_info info = {};
    info.struct_size = sizeof info;
    check(clba_problem_get_info(problem, &info));
    return info;
}

}  // namespace cli
