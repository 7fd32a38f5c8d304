// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <memory>

#include "optimizer/minimizer.hpp"

namespace clba {

// Refines a problem's state on a device. `device` is the problem's mirror: it is made if it is
// empty or of another context or precision; it must be emptied when the problem's structure
// changes, and told (is_stale) what else does.
Summary solve(Problem& problem, const std::shared_ptr<Context>& context,
              const MinimizerOptions& options, Precision precision,
              std::unique_ptr<DeviceProblem>& device);

// The problem's mirror for this context and precision, with its state uploaded.
DeviceProblem& mirror(const Problem& problem, const std::shared_ptr<Context>& context,
                      Precision precision, std::unique_ptr<DeviceProblem>& device);

}  // namespace clba
