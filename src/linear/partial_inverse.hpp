// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>

#include "linear/partial_factor.hpp"

namespace clba {

// Z = A^-1 at the rows and columns of a front whose factor L = [L1; L2] has m x p. z is m x m, both
// triangles; on entry its last m - p rows and columns are known:
//   W = L1^-T L2^T,  Z_12 = -W Z_22,  Z_11 = L1^-T L1^-1 - Z_12 W^T
// (Takahashi, Fagan and Chin 1973, by blocks). scratch: partial_inverse_scratch numbers.
template <class Real>
void partial_inverse(const Real* l, int64_t l_stride, int64_t m, int64_t p, Real* z,
                     int64_t z_stride, Real* scratch, const DenseThreads<Real>& threads);
template <class Real>
int64_t partial_inverse_scratch(int64_t m, int64_t p);

}  // namespace clba
