// SPDX-License-Identifier: Apache-2.0
// Conjugate gradients whose scalars and decisions stay on the device. A sum is num_partials partials from some place
// in `partials`, one a work-group of the kernels that made it, which every work-group adds up again in
// the same order:
//   rho = r . z,  curvature = p . q,  alpha = rho / curvature,  beta = rho / rho before
// z and q share a buffer: z is read last where q is first written.
// Writers: one element each; controls: the first group.
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

// Where the iterations are. There are two, which take turns: a launch reads one while its first group
// writes the other.
#define MODEL 0       // Q, the quadratic model at x
#define ITERATIONS 1  // that have moved x
#define STATUS 2
#define RUNNING 0
#define CONVERGED 1
#define BROKEN_DOWN 2  // rho or the curvature is not positive: what was found before is kept
#define NOT_FINITE 3   // the model

// Control after iteration k, in which Q falls by alpha rho / 2: it converges where that is a share of Q
// below eta / k, or where rho is 0 from the start.
static inline void update_control(global const WIDE* before, global WIDE* after, int k,
                                  int min_iterations, WIDE eta, WIDE rho, WIDE curvature) {
    WIDE model = before[MODEL], iterations = before[ITERATIONS], status = before[STATUS];
    if (status == RUNNING && k == 1 && rho == 0) {
        status = CONVERGED;
    } else if (status == RUNNING &&
               !(rho > 0 && curvature > 0 && isfinite(rho) && isfinite(curvature))) {
        status = BROKEN_DOWN;
    } else if (status == RUNNING) {
        const WIDE decrease = rho * (rho / curvature) / 2;
        model -= decrease;
        iterations = k;
        if (!isfinite(model))
            status = NOT_FINITE;
        else if (k >= min_iterations && k * decrease < -eta * model)
            status = CONVERGED;
    }
    after[MODEL] = model;
    after[ITERATIONS] = iterations;
    after[STATUS] = status;
}

// Iteration k: x += alpha p, r -= alpha q, and `after` follows from `before` if updates. Nothing moves
// unless it is running, and rho and the curvature are positive: what follows from them then, NaN
// perhaps, is not added to x.
KERNEL void pcg_step(int n, int num_partials, int rho, int curvature,
                     global const WIDE* restrict partials, global const WIDE* restrict p,
                     global const WIDE* restrict q, global WIDE* restrict x,
                     global WIDE* restrict r, int updates, int k, int min_iterations, WIDE eta,
                     int before, int after, global WIDE* controls) {
    const int begin = share_begin(n), end = share_end(n);
    const WIDE of_p = sum_partials(partials + curvature, num_partials);
    const WIDE of_r = sum_partials(partials + rho, num_partials);
    const bool moves = controls[before + STATUS] == RUNNING && of_p > 0 && of_r > 0;
    const WIDE alpha = moves ? of_r / of_p : (WIDE)0;
    LANES(i, begin, end) {
        x[i] += moves ? alpha * p[i] : (WIDE)0;
        r[i] -= moves ? alpha * q[i] : (WIDE)0;
    }
    if (updates && get_group_id(0) == 0 && IS_FIRST_LANE)
        update_control(controls + before, controls + after, k, min_iterations, eta, of_r, of_p);
}
