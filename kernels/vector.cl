// SPDX-License-Identifier: Apache-2.0
// Vectors of doubles for PCG and for the step: each work-group has a contiguous share. A sum leaves
// one partial a group, from first_partial, which the host adds up in order.
// Writers: one element each; partials: one a group.
#define LANE_WIDTH 8
#include "lanes.clh"

KERNEL void dot_product(int n, global const double* restrict x, global const double* restrict y,
                        int first_partial, global double* restrict partials, local double* scratch) {
    const int begin = share_begin(n), end = share_end(n);
    double sum = 0;
    LANES(i, begin, end) sum += x[i] * y[i];
    const double total = GROUP_SUM(sum, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

// |x|^2 of REALs, summed in double.
KERNEL void squared_norm(int n, global const REAL* restrict x, int first_partial,
                         global double* restrict partials, local double* scratch) {
    const int begin = share_begin(n), end = share_end(n);
    double sum = 0;
    LANES(i, begin, end) sum += (double)x[i] * x[i];
    const double total = GROUP_SUM(sum, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

KERNEL void max_abs(int n, global const double* restrict x, int first_partial,
                    global double* restrict partials, local double* scratch) {
    const int begin = share_begin(n), end = share_end(n);
    double largest = 0;
    // A NaN must not be lost, as fmax would: it is told by x != x and turned into infinity.
    LANES(i, begin, end) {
        const double value = x[i] == x[i] ? fabs(x[i]) : INFINITY;
        largest = value > largest ? value : largest;
    }
    const double total = GROUP_MAX(largest, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

// y = a x + b y; what y held does not matter if b is 0.
KERNEL void scale_and_add(int n, double a, global const double* restrict x, double b,
                          global double* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) y[i] = a * x[i] + (b == 0 ? 0.0 : b * y[i]);
}

// y += lambda d2 x.
KERNEL void add_damping(int n, double lambda, global const double* restrict d2,
                        global const double* restrict x, global double* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) y[i] += lambda * d2[i] * x[i];
}

// One step of conjugate gradients: x += alpha p, r -= alpha q; partials of x . (b + r).
KERNEL void pcg_step(int n, double alpha, global const double* restrict p,
                     global const double* restrict q, global const double* restrict b,
                     global double* restrict x, global double* restrict r,
                     int first_partial, global double* restrict partials, local double* scratch) {
    const int begin = share_begin(n), end = share_end(n);
    double sum = 0;
    LANES(i, begin, end) {
        const double next_x = x[i] + alpha * p[i];
        const double next_r = r[i] - alpha * q[i];
        x[i] = next_x;
        r[i] = next_r;
        sum += next_x * (b[i] + next_r);
    }
    const double total = GROUP_SUM(sum, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

// y = (REAL)x, and back.
KERNEL void to_real(int n, global const double* restrict x, global REAL* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) y[i] = (REAL)x[i];
}
KERNEL void from_real(int n, global const REAL* restrict x, global double* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) y[i] = (double)x[i];
}

// x_i = 0 where scale_i is 0: constant parameters.
KERNEL void mask_constants(int n, global const double* restrict scale, global double* restrict x) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) x[i] = scale[i] > 0 ? x[i] : 0.0;
}
