// SPDX-License-Identifier: Apache-2.0
// Vectors of WIDE for PCG and for the step: each work-group has a contiguous share. A sum leaves
// one partial a group, from first_partial, which the host adds up in order.
// Writers: one element each; partials: one a group.
#define LANE_WIDTH 8
#include "lanes.clh"

KERNEL void dot_product(int n, global const WIDE* restrict x, global const WIDE* restrict y,
                        int first_partial, global WIDE* restrict partials, local WIDE* scratch) {
    const int begin = share_begin(n), end = share_end(n);
    WIDE sum = 0;
    LANES(i, begin, end) sum += x[i] * y[i];
    const WIDE total = GROUP_SUM(sum, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

// |x|^2 of REALs, summed in WIDE.
KERNEL void squared_norm(int n, global const REAL* restrict x, int first_partial,
                         global WIDE* restrict partials, local WIDE* scratch) {
    const int begin = share_begin(n), end = share_end(n);
    WIDE sum = 0;
    LANES(i, begin, end) sum += (WIDE)x[i] * x[i];
    const WIDE total = GROUP_SUM(sum, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

KERNEL void max_abs(int n, global const WIDE* restrict x, int first_partial,
                    global WIDE* restrict partials, local WIDE* scratch) {
    const int begin = share_begin(n), end = share_end(n);
    WIDE largest = 0;
    // A NaN must not be lost, as fmax would: it is told by x != x and turned into infinity.
    LANES(i, begin, end) {
        const WIDE value = x[i] == x[i] ? fabs(x[i]) : (WIDE)INFINITY;
        largest = value > largest ? value : largest;
    }
    const WIDE total = GROUP_MAX(largest, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

// y = a x + b y; what y held does not matter if b is 0.
KERNEL void scale_and_add(int n, WIDE a, global const WIDE* restrict x, WIDE b,
                          global WIDE* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) y[i] = a * x[i] + (b == 0 ? (WIDE)0 : b * y[i]);
}

// y = (REAL)x, and back: y = x or y += x.
KERNEL void to_real(int n, global const WIDE* restrict x, global REAL* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) y[i] = (REAL)x[i];
}
KERNEL void from_real(int n, global const REAL* restrict x, int is_added,
                      global WIDE* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) y[i] = (is_added ? y[i] : (WIDE)0) + (WIDE)x[i];
}

// x_i = 0 where scale_i is 0: constant parameters.
KERNEL void mask_constants(int n, global const WIDE* restrict scale, global WIDE* restrict x) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) x[i] = scale[i] > 0 ? x[i] : (WIDE)0;
}
