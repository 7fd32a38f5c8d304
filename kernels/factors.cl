// SPDX-License-Identifier: Apache-2.0
// Damping, and inverses of damped diagonal blocks as inverse Cholesky factors: A = L L^T, G = L^-1,
// A^-1 = G^T G. Stored in REAL, G^T G stays positive definite, which a rounded A^-1 may not.
// Scalars of scale 0 are constant: they are left out of A, and their rows and columns of G are 0.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "point_root.clh"

#ifndef MAX_BLOCK
#define MAX_BLOCK 14
#endif
#define MAX_TRIANGLE (MAX_BLOCK * (MAX_BLOCK + 1) / 2)

// D_i^2 of scalar i (clba.h, CLBA_DAMPING_*), with c_i its scale and d_i = diag(J^T J)_i:
//   DAMPING 1, marquardt    clamp(c^2 d, smallest, largest) / c^2
//   DAMPING 2, levenberg    (s / c)^2 with s = 1 + sqrt(d), of the first linearisation
//   DAMPING 3, uncertainty  1 / c^2
#ifndef DAMPING
#define DAMPING 1
#endif
// 1: points have scales; 0: theirs are 1.
#ifndef SCALED_POINTS
#define SCALED_POINTS 0
#endif
static inline WIDE damping(WIDE c, WIDE d, WIDE smallest, WIDE largest) {
    const WIDE c2 = c * c;
#if DAMPING == 1
    const WIDE value = fmin(fmax(c2 * d, smallest), largest) / c2;
#elif DAMPING == 2
    const WIDE s = 1 + sqrt(d);
    const WIDE value = s * s / c2;
#else
    const WIDE value = 1 / c2;
#endif
    return c > 0 ? value : (WIDE)0;
}

// D^2 of n scalars of the F side with the diagonal of J_F^T J_F.
// Writers: one element each.
KERNEL void image_damping(WIDE smallest, WIDE largest, int n,
                          global const WIDE* restrict diagonal, global const WIDE* restrict scale,
                          global WIDE* restrict d2) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) d2[i] = damping(scale[i], diagonal[i], smallest, largest);
}

// V = L L^T of point i, of n slots: xx, yx, yy, zx, zy, zz.
static inline void load_point_block(global const REAL* roots, int n, int i, WIDE* v) {
    const WIDE l00 = roots[i], l10 = roots[n + i], l11 = roots[2 * n + i];
    const WIDE l20 = roots[3 * n + i], l21 = roots[4 * n + i], l22 = roots[5 * n + i];
    v[0] = l00 * l00;
    v[1] = l10 * l00;
    v[2] = l10 * l10 + l11 * l11;
    v[3] = l20 * l00;
    v[4] = l20 * l10 + l21 * l11;
    v[5] = l20 * l20 + l21 * l21 + l22 * l22;
}

static inline WIDE load_point_scale(global const WIDE* scale, int i) {
#if SCALED_POINTS
    return scale[i];
#else
    return 1;
#endif
}

// D^2 of the points: 3 rows. scale is read where SCALED_POINTS is 1. Spare slots get some value too.
// Writers: one point each.
KERNEL void point_damping(WIDE smallest, WIDE largest, int num_point_slots,
                          global const REAL* restrict roots, global const WIDE* restrict scale,
                          global WIDE* restrict d2) {
    const int n = num_point_slots;
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) {
        WIDE v[6];
        load_point_block(roots, n, i, v);
        d2[i] = damping(load_point_scale(scale, i), v[0], smallest, largest);
        d2[n + i] = damping(load_point_scale(scale, n + i), v[2], smallest, largest);
        d2[2 * n + i] = damping(load_point_scale(scale, 2 * n + i), v[5], smallest, largest);
    }
}

#define PIVOT_SHARE (8 * MAX_BLOCK * WIDE_EPSILON)

// G of A = (packed lower triangle at matrix_offset) + lambda D^2, in its place; all 0 and counted if A is
// not positive definite.
// Writers: one block each; failures: one count a group.
KERNEL void factor_image_blocks(WIDE lambda, int num_blocks,
                                global const int* restrict block_offset,
                                global const int* restrict block_size,
                                global const int* restrict matrix_offset,
                                global WIDE* restrict matrices,
                                global const WIDE* restrict scale,
                                global const WIDE* restrict d2,
                                global int* restrict failures) {
    int failed = 0;
    const int end = share_end(num_blocks);
    LANES_UNVECTORIZED(block, share_begin(num_blocks), end) {
        const int size = block_size[block], offset = block_offset[block];
        global WIDE* matrix = matrices + matrix_offset[block];
        WIDE a[MAX_TRIANGLE];
        bool is_definite = true;
        // Row by row: L, then L^-1 in its place from the last row up would lose L; so first L.
        for (int row = 0; row < size; ++row) {
            const int at = row * (row + 1) / 2;
            const bool is_free = scale[offset + row] > 0;
            for (int k = 0; k <= row; ++k) {
                const bool both_free = is_free && scale[offset + k] > 0;
                WIDE value = both_free ? matrix[at + k] : (WIDE)0;
                if (k == row) value = is_free ? value + lambda * d2[offset + row] : (WIDE)1;
                const WIDE whole = value;
                const int above = k * (k + 1) / 2;
                for (int m = 0; m < k; ++m) value -= a[at + m] * a[above + m];
                if (k < row) {
                    a[at + k] = value / a[above + k];
                } else {
#ifdef NO_DOUBLE
                    // What rounding takes from a pivot only makes a preconditioner a little worse.
                    value = value < PIVOT_SHARE * whole ? PIVOT_SHARE * whole : value;
#endif
                    is_definite = is_definite && value > 0 && isfinite(value);
                    a[at + k] = sqrt(is_definite ? value : (WIDE)1);
                }
            }
        }
        // G = L^-1, column by column: G_cc = 1 / L_cc, G_rc = -(sum L_rm G_mc) / L_rr.
        for (int column = 0; column < size; ++column) {
            for (int row = column; row < size; ++row) {
                const int at = row * (row + 1) / 2;
                WIDE value = row == column ? (WIDE)1 : (WIDE)0;
                for (int m = column; m < row; ++m)
                    value -= a[at + m] * matrix[m * (m + 1) / 2 + column];
                matrix[at + column] = value / a[at + row];
            }
        }
        for (int row = 0; row < size; ++row)
            for (int k = 0; k <= row; ++k)
                if (!is_definite || !(scale[offset + row] > 0) || !(scale[offset + k] > 0))
                    matrix[row * (row + 1) / 2 + k] = 0;
        failed += is_definite ? 0 : 1;
    }
#if LANE_LOOP
    failures[get_group_id(0)] = failed;
#else
    failures[get_global_id(0)] = failed;
#endif
}

// G of V + lambda D^2 of each point: 6 rows of REAL, g00, g10, g11, g20, g21, g22. fixed_d2 is D^2 where
// DAMPING is 2. Spare slots: G is finite or 0, and unused.
// With LEAST_PIVOT_SHARE, and not without doubles: coordinates of which elimination leaves no more than
// that share have a row of 0 in G, and do not count as failures.
// Writers: one point each; failures: one count a work-item.
KERNEL void factor_point_blocks(WIDE smallest, WIDE largest, WIDE lambda, int num_point_slots,
                                global const REAL* restrict roots,
                                global const WIDE* restrict scale,
                                global const WIDE* restrict fixed_d2,
                                global REAL* restrict factors, global int* restrict failures) {
    const int n = num_point_slots;
    const int begin = share_begin(n), end = share_end(n);
    WIDE failed = 0;
    LANES(i, begin, end) {
        WIDE v[6], d2[3];
        load_point_block(roots, n, i, v);
        const WIDE scales[3] = {load_point_scale(scale, i), load_point_scale(scale, n + i),
                                load_point_scale(scale, 2 * n + i)};
#if DAMPING == 2
        d2[0] = fixed_d2[i];
        d2[1] = fixed_d2[n + i];
        d2[2] = fixed_d2[2 * n + i];
#else
        d2[0] = damping(scales[0], v[0], smallest, largest);
        d2[1] = damping(scales[1], v[2], smallest, largest);
        d2[2] = damping(scales[2], v[5], smallest, largest);
#endif
        const bool free0 = scales[0] > 0, free1 = scales[1] > 0, free2 = scales[2] > 0;
        // is_definite is false for NaN and for infinities too.
#ifdef NO_DOUBLE
        // sqrt(lambda) D as three more rows of J_E.
        WIDE l[6] = {free0 ? roots[i] : (WIDE)0,         free1 ? roots[n + i] : (WIDE)0,
                     free1 ? roots[2 * n + i] : (WIDE)0, free2 ? roots[3 * n + i] : (WIDE)0,
                     free2 ? roots[4 * n + i] : (WIDE)0, free2 ? roots[5 * n + i] : (WIDE)0};
        add_row_to_root(l, free0 ? sqrt(lambda * d2[0]) : (WIDE)1, 0, 0);
        add_row_to_root(l, 0, free1 ? sqrt(lambda * d2[1]) : (WIDE)1, 0);
        add_row_to_root(l, 0, 0, free2 ? sqrt(lambda * d2[2]) : (WIDE)1);
        const REAL g00 = 1 / l[0], g11 = 1 / l[2], g22 = 1 / l[5];
        const REAL l10 = l[1] * g00, l20 = l[3] * g00, l21 = l[4] * g11;
        const REAL g10 = -l10 * g11, g21 = -l21 * g22, g20 = (l21 * l10 - l20) * g22;
        const bool is_definite = l[0] > 0 && l[2] > 0 && l[5] > 0 && l[0] + l[2] + l[5] < INFINITY;
#else
        const WIDE a00 = free0 ? v[0] + lambda * d2[0] : (WIDE)1;
        const WIDE a10 = free0 && free1 ? v[1] : (WIDE)0;
        const WIDE a11 = free1 ? v[2] + lambda * d2[1] : (WIDE)1;
        const WIDE a20 = free0 && free2 ? v[3] : (WIDE)0;
        const WIDE a21 = free1 && free2 ? v[4] : (WIDE)0;
        const WIDE a22 = free2 ? v[5] + lambda * d2[2] : (WIDE)1;
        // A = L D L^T with a unit lower triangle L; G = D^-1/2 L^-1.
#ifdef LEAST_PIVOT_SHARE
        const bool has0 = a00 > 0;
        const WIDE inverse0 = has0 ? 1 / a00 : (WIDE)0;
        const WIDE l10 = a10 * inverse0, l20 = a20 * inverse0;
        const WIDE left1 = a11 - l10 * a10;
        const bool has1 = left1 > (WIDE)LEAST_PIVOT_SHARE * a11;
        const WIDE l21 = has1 ? (a21 - l20 * a10) / left1 : (WIDE)0;
        const WIDE left2 = a22 - l20 * a20 - l21 * l21 * left1;
        const bool has2 = left2 > (WIDE)LEAST_PIVOT_SHARE * a22;
        // 1 / sqrt(infinity) = 0.
        const WIDE p0 = has0 ? a00 : (WIDE)INFINITY, p1 = has1 ? left1 : (WIDE)INFINITY;
        const WIDE p2 = has2 ? left2 : (WIDE)INFINITY;
        const bool is_definite = a00 + a11 + a22 < INFINITY;
#else
        const WIDE inverse0 = 1 / a00;
        const WIDE l10 = a10 * inverse0, l20 = a20 * inverse0;
        const WIDE p0 = a00;
        const WIDE p1 = a11 - l10 * a10;
        const WIDE l21 = (a21 - l20 * a10) / p1;
        const WIDE p2 = a22 - l20 * a20 - l21 * l21 * p1;
        const bool is_definite = a00 > 0 && p1 > 0 && p2 > 0 && a00 + p1 + p2 < INFINITY;
#endif
        const REAL g00 = 1 / sqrt((REAL)p0), g11 = 1 / sqrt((REAL)p1), g22 = 1 / sqrt((REAL)p2);
        const REAL g10 = -(REAL)l10 * g11, g21 = -(REAL)l21 * g22;
        const REAL g20 = (REAL)(l21 * l10 - l20) * g22;
#endif
        failed += is_definite ? (WIDE)0 : (WIDE)1;
        factors[i] = is_definite && free0 ? g00 : (REAL)0;
        factors[n + i] = is_definite && free0 && free1 ? g10 : (REAL)0;
        factors[2 * n + i] = is_definite && free1 ? g11 : (REAL)0;
        factors[3 * n + i] = is_definite && free0 && free2 ? g20 : (REAL)0;
        factors[4 * n + i] = is_definite && free1 && free2 ? g21 : (REAL)0;
        factors[5 * n + i] = is_definite && free2 ? g22 : (REAL)0;
    }
#if LANE_LOOP
    failures[get_group_id(0)] = (int)failed;
#else
    failures[get_global_id(0)] = (int)failed;
#endif
}

// z = G^T G r, block by block.
// Writers: group shares of blocks.
KERNEL void apply_image_factors(int num_blocks, global const int* restrict block_offset,
                                global const int* restrict block_size,
                                global const int* restrict matrix_offset,
                                global const WIDE* restrict factors,
                                global const WIDE* restrict r, global WIDE* restrict z) {
    const int end = share_end(num_blocks);
    LANES_UNVECTORIZED(block, share_begin(num_blocks), end) {
        const int size = block_size[block], offset = block_offset[block];
        global const WIDE* g = factors + matrix_offset[block];
        WIDE b[MAX_BLOCK];
        for (int row = 0; row < size; ++row) {
            WIDE sum = 0;
            for (int k = 0; k <= row; ++k) sum += g[row * (row + 1) / 2 + k] * r[offset + k];
            b[row] = sum;
        }
        for (int k = 0; k < size; ++k) {
            WIDE sum = 0;
            for (int row = k; row < size; ++row) sum += g[row * (row + 1) / 2 + k] * b[row];
            z[offset + k] = sum;
        }
    }
}

// z = G^T G r, point by point; r and z are 3 rows of WIDE.
// Writers: one point each.
KERNEL void apply_point_factors(int num_point_slots, global const REAL* restrict factors,
                                global const WIDE* restrict r, global WIDE* restrict z) {
    const int n = num_point_slots;
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) {
        const WIDE g00 = factors[i], g10 = factors[n + i], g11 = factors[2 * n + i];
        const WIDE g20 = factors[3 * n + i], g21 = factors[4 * n + i], g22 = factors[5 * n + i];
        const WIDE r0 = r[i], r1 = r[n + i], r2 = r[2 * n + i];
        const WIDE b0 = g00 * r0, b1 = g10 * r0 + g11 * r1;
        const WIDE b2 = g20 * r0 + g21 * r1 + g22 * r2;
        z[i] = g00 * b0 + g10 * b1 + g20 * b2;
        z[n + i] = g11 * b1 + g21 * b2;
        z[2 * n + i] = g22 * b2;
    }
}
