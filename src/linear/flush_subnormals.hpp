// SPDX-License-Identifier: Apache-2.0
#pragma once
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

namespace clba {

// While it lives, the thread takes subnormal numbers as 0, in operands and in results: they make
// processors of x86 slower by two orders of magnitude and come up where the fill of a diagonally
// dominant matrix decays. Elsewhere it does nothing.
class FlushSubnormals {
public:
#if defined(__SSE2__)
    FlushSubnormals() : saved_(_mm_getcsr()) {
        _mm_setcsr(saved_ | 0x8040);
    }
    ~FlushSubnormals() {
        _mm_setcsr(saved_);
    }
#else
    FlushSubnormals() = default;
    ~FlushSubnormals() {}
#endif
    FlushSubnormals(const FlushSubnormals&) = delete;
    FlushSubnormals& operator=(const FlushSubnormals&) = delete;

private:
#if defined(__SSE2__)
    unsigned int saved_;
#endif
};

}  // namespace clba
