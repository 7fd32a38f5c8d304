// SPDX-License-Identifier: Apache-2.0
// Residuals and cost: one work-group a tile of points.
//   cost = 1/2 sum rho(|r|^2); residuals, if wanted, are sqrt(rho') r.
// Writers: group t alone writes tile_sums[4 (first_sum + t) ...] and the residuals of its runs' slots.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "tiles.clh"
#include "observation.clh"

KERNEL void residual(TILES,
                     global const WIDE* restrict xy,         // run by run: 2 rows of its slots
                     global const WIDE* restrict whitening,  // 3 rows of its slots, or NULL
                     global const WIDE* restrict images,     // IMAGE_RECORD an image
                     global const WIDE* restrict points,     // 3 rows a part (positions.clh)
                     WIDE loss_scale,
                     global WIDE* restrict residuals,        // 2 rows of its slots, or NULL
                     int first_sum,
                     global WIDE* restrict tile_sums,        // cost, behind, singular, 0
                     local WIDE* scratch) {
    const int tile = get_group_id(0);
    const int num_points = tile_num_points[tile];
    global const WIDE* of_tile = points + tile_points[tile];
    WIDE cost = 0, cost_low = 0, behind = 0, singular = 0;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const image_t image = load_image(images + IMAGE_RECORD * run_image[run]);
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const ushort* point = slot_point + first;
        global const WIDE* observed = xy + 2 * (long)first;
        fetch_next_run(observed + 2 * (long)n, n, 2 * (int)sizeof(WIDE));
#if WHITENED
        global const WIDE* factor = whitening + 3 * (long)first;
#endif
        global WIDE* out = residuals + 2 * (long)first;
        WIDE of_run = 0;
        LANES(l, 0, n) {
            const int i = point[l];
            const view_t p = view(&image, of_tile, num_point_slots, i);
            const bool is_real = i < num_points;
            WIDE rx, ry;
            camera_pixel(image.theta, p.u, p.v, &rx, &ry);
            rx -= observed[l];
            ry -= observed[n + l];
#if WHITENED
            ry = factor[n + l] * rx + factor[2 * n + l] * ry;
            rx = factor[l] * rx;
#endif
            rx = is_real ? rx : (WIDE)0;
            ry = is_real ? ry : (WIDE)0;
            WIDE rho, slope;
            loss(rx * rx + ry * ry, loss_scale, &rho, &slope);
            of_run += rho;
            behind += is_real && p.scale < 0 ? (WIDE)1 : (WIDE)0;
            singular += is_real && p.is_singular ? (WIDE)1 : (WIDE)0;
            if (residuals) {
                const WIDE weight = sqrt(slope);
                out[l] = weight * rx;
                out[n + l] = weight * ry;
            }
        }
        // With its rounding errors (Kahan, Babuska, Neumaier): no term is negative.
        const WIDE sum = cost + of_run;
        cost_low += cost >= of_run ? (cost - sum) + of_run : (of_run - sum) + cost;
        cost = sum;
    }
    const WIDE group_cost = GROUP_SUM(cost + cost_low, scratch);
    const WIDE group_behind = GROUP_SUM(behind, scratch);
    const WIDE group_singular = GROUP_SUM(singular, scratch);
    if (IS_FIRST_LANE) {
        tile_sums[4 * (first_sum + tile)] = (WIDE)0.5 * group_cost;
        tile_sums[4 * (first_sum + tile) + 1] = group_behind;
        tile_sums[4 * (first_sum + tile) + 2] = group_singular;
        tile_sums[4 * (first_sum + tile) + 3] = 0;
    }
}
