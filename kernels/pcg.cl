// SPDX-License-Identifier: Apache-2.0
// Conjugate gradients whose scalars stay on the device. A sum is num_partials partials from some place
// in `partials`, one a work-group of the kernels that made it, which every work-group adds up again in
// the same order:
//   rho = r . z,  curvature = p . q,  alpha = rho / curvature,  beta = rho / rho before
// z and q share a buffer: z is read last where q is first written.
// Writers: one element each.
#define LANE_WIDTH 8
#include "lanes.clh"

static inline WIDE sum_partials(global const WIDE* partials, int num_partials) {
    WIDE sum = 0;
    for (int i = 0; i < num_partials; ++i) sum += partials[i];
    return sum;
}

// p = z + beta p and q = lambda d2 p, in the place of z; beta is 0 if is_first, whatever p held.
KERNEL void pcg_direction(int n, int is_first, int num_partials, int rho, int rho_before,
                          global const WIDE* restrict partials, WIDE lambda,
                          global const WIDE* restrict d2, global WIDE* restrict p,
                          global WIDE* restrict zq) {
    const int begin = share_begin(n), end = share_end(n);
    const WIDE beta = is_first ? (WIDE)0
                               : sum_partials(partials + rho, num_partials) /
                                     sum_partials(partials + rho_before, num_partials);
    LANES(i, begin, end) {
        const WIDE next = zq[i] + (is_first ? (WIDE)0 : beta * p[i]);
        p[i] = next;
        zq[i] = lambda * d2[i] * next;
    }
}

// x += alpha p, r -= alpha q. Nothing moves unless rho and the curvature are positive: what follows from
// them then, NaN perhaps, is not added to x.
KERNEL void pcg_step(int n, int num_partials, int rho, int curvature,
                     global const WIDE* restrict partials, global const WIDE* restrict p,
                     global const WIDE* restrict q, global WIDE* restrict x,
                     global WIDE* restrict r) {
    const int begin = share_begin(n), end = share_end(n);
    const WIDE of_p = sum_partials(partials + curvature, num_partials);
    const WIDE of_r = sum_partials(partials + rho, num_partials);
    const bool moves = of_p > 0 && of_r > 0;
    const WIDE alpha = moves ? of_r / of_p : (WIDE)0;
    LANES(i, begin, end) {
        x[i] += moves ? alpha * p[i] : (WIDE)0;
        r[i] -= moves ? alpha * q[i] : (WIDE)0;
    }
}
