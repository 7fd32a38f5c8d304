// SPDX-License-Identifier: Apache-2.0
// Blocks of U - W V^-1 W^T for pairs of images. With A = J_E G^T and V^-1 = G^T G,
//   S_ij = sum J_Fa^T (delta_ab I - A_a A_b^T) J_Fb
// over the pairs (a, b) of observations of one point, a by image i and b by image j.
#include "lanes.clh"
#include "tiles.clh"
#include "jacobian.clh"
#include "schur_records.clh"

// The record of each observation of the tiles from first_tile.
// Writers: a tile's group alone writes the records of its runs' slots, counted from first_record.
KERNEL void schur_records(TILES, global const WIDE* restrict images,
                          global const REAL* restrict rows,
                          global const REAL* restrict point_factors,  // G, 6 rows
                          int first_tile, int first_record, global char* restrict records) {
    const int tile = first_tile + get_group_id(0);
    global const REAL* g = point_factors + tile_points[tile];
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const run_t shared = load_run(rows, first, n, images + IMAGE_RECORD * run_image[run]);
        global const ushort* point = slot_point + first;
        global char* out = records + RECORD_BYTES * (long)(first_record + first);
        global REAL* f_out = (global REAL*)out;
        global WIDE* a_out = (global WIDE*)(out + POINT_OFFSET);
        const int f_step = RECORD_BYTES / (int)sizeof(REAL);
        const int a_step = RECORD_BYTES / (int)sizeof(WIDE);
        LANES(l, 0, n) {
            const jacobian_t j = load_jacobian(&shared, l);
            REAL f[2 * COLUMNS], e[6];
            image_rows(&j, f);
            point_rows(&shared, &j, e);
#pragma unroll
            for (int k = 0; k < COLUMNS; ++k) {
                f_out[f_step * l + k] = f[k];
                f_out[f_step * l + MAX_COLUMNS + k] = f[COLUMNS + k];
            }
            const int i = point[l];
            const WIDE g00 = g[i], g10 = g[num_point_slots + i], g11 = g[2 * num_point_slots + i];
            const WIDE g20 = g[3 * num_point_slots + i], g21 = g[4 * num_point_slots + i];
            const WIDE g22 = g[5 * num_point_slots + i];
#pragma unroll
            for (int row = 0; row < 2; ++row) {
                const WIDE e0 = e[3 * row], e1 = e[3 * row + 1], e2 = e[3 * row + 2];
                a_out[a_step * l + 3 * row] = g00 * e0;
                a_out[a_step * l + 3 * row + 1] = g10 * e0 + g11 * e1;
                a_out[a_step * l + 3 * row + 2] = g20 * e0 + g21 * e1 + g22 * e2;
            }
        }
    }
}
