// SPDX-License-Identifier: Apache-2.0
// Blocks of U - W V^-1 W^T for pairs of images. With A = J_E G^T and V^-1 = G^T G,
//   S_ij = sum J_Fa^T (delta_ab I - A_a A_b^T) J_Fb
// over the pairs (a, b) of observations of one point, a by image i and b by image j.
#include "lanes.clh"
#include "tiles.clh"
#include "jacobian.clh"

#if COLUMNS > 16
#error "records hold 16 columns"
#endif

// What a pair needs of each observation: the two rows of J_F, padded to 16 numbers, and A in 6 of 8.
// Writers: group t alone writes the records of its runs' slots, counted from first_record.
KERNEL void schur_records(TILES, global const WIDE* restrict images,
                          global const REAL* restrict rows,
                          global const REAL* restrict point_factors,  // G, 6 rows
                          int first_record, global REAL* restrict image_records,
                          global WIDE* restrict point_records) {
    const int tile = get_group_id(0);
    global const REAL* g = point_factors + tile_points[tile];
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const run_t shared = load_run(rows, first, n, images + IMAGE_RECORD * run_image[run]);
        global const ushort* point = slot_point + first;
        global REAL* f_out = image_records + 32 * (long)(first_record + first);
        global WIDE* a_out = point_records + 8 * (long)(first_record + first);
        LANES(l, 0, n) {
            const jacobian_t j = load_jacobian(&shared, l);
            REAL f[2 * COLUMNS], e[6];
            image_rows(&j, f);
            point_rows(&shared, &j, e);
#pragma unroll
            for (int k = 0; k < COLUMNS; ++k) {
                f_out[32 * l + k] = f[k];
                f_out[32 * l + 16 + k] = f[COLUMNS + k];
            }
#pragma unroll
            for (int k = COLUMNS; k < 16; ++k) f_out[32 * l + k] = f_out[32 * l + 16 + k] = 0;
            const int i = point[l];
            const WIDE g00 = g[i], g10 = g[num_point_slots + i], g11 = g[2 * num_point_slots + i];
            const WIDE g20 = g[3 * num_point_slots + i], g21 = g[4 * num_point_slots + i];
            const WIDE g22 = g[5 * num_point_slots + i];
#pragma unroll
            for (int row = 0; row < 2; ++row) {
                const WIDE e0 = e[3 * row], e1 = e[3 * row + 1], e2 = e[3 * row + 2];
                a_out[8 * l + 3 * row] = g00 * e0;
                a_out[8 * l + 3 * row + 1] = g10 * e0 + g11 * e1;
                a_out[8 * l + 3 * row + 2] = g20 * e0 + g21 * e1 + g22 * e2;
            }
        }
    }
}
