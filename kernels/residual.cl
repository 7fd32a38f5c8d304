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
                     global const WIDE* restrict points,     // 3 rows
                     WIDE loss_scale,
                     global WIDE* restrict residuals,        // 2 rows of its slots, or NULL
                     int first_sum,
                     global WIDE* restrict tile_sums,        // cost, behind, singular, 0
                     local WIDE* scratch) {
    const int tile = get_group_id(0);
    const int num_points = tile_num_points[tile];
    global const WIDE* px = points + tile_points[tile];
    global const WIDE* py = px + num_point_slots;
    global const WIDE* pz = py + num_point_slots;
    WIDE cost = 0, behind = 0, singular = 0;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const image_t image = load_image(images + IMAGE_RECORD * run_image[run]);
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const ushort* point = slot_point + first;
        global const WIDE* observed = xy + 2 * (long)first;
#if WHITENED
        global const WIDE* factor = whitening + 3 * (long)first;
#endif
        global WIDE* out = residuals + 2 * (long)first;
        LANES(l, 0, n) {
            const int i = point[l];
            const view_t p = view(&image, px[i], py[i], pz[i]);
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
            cost += rho;
            behind += is_real && p.scale < 0 ? (WIDE)1 : (WIDE)0;
            singular += is_real && p.is_singular ? (WIDE)1 : (WIDE)0;
            if (residuals) {
                const WIDE weight = sqrt(slope);
                out[l] = weight * rx;
                out[n + l] = weight * ry;
            }
        }
    }
    const WIDE group_cost = GROUP_SUM(cost, scratch);
    const WIDE group_behind = GROUP_SUM(behind, scratch);
    const WIDE group_singular = GROUP_SUM(singular, scratch);
    if (IS_FIRST_LANE) {
        tile_sums[4 * (first_sum + tile)] = (WIDE)0.5 * group_cost;
        tile_sums[4 * (first_sum + tile) + 1] = group_behind;
        tile_sums[4 * (first_sum + tile) + 2] = group_singular;
        tile_sums[4 * (first_sum + tile) + 3] = 0;
    }
}
