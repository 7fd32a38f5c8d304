// SPDX-License-Identifier: Apache-2.0
// Residuals and cost: one work-group a tile of points.
//   cost = 1/2 sum rho(|r|^2); residuals, if wanted, are sqrt(rho') r.
// Writers: group t alone writes tile_sums[4 t ...] and the residuals of its runs' slots.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "observation.clh"

KERNEL void residual(global const int* restrict tile_points,      // first point slot of each tile
                     global const int* restrict tile_num_points,  // real points of each tile
                     global const int* restrict tile_runs,        // first run of each tile, and end
                     global const int* restrict run_image,
                     global const int* restrict run_slots,        // first slot of each run, and end
                     global const ushort* restrict slot_point,    // counted from the tile's first
                     global const double* restrict xy,            // run by run: 2 rows of its slots
                     global const double* restrict whitening,     // 3 rows of its slots, or NULL
                     global const double* restrict images,        // IMAGE_RECORD an image
                     int num_point_slots, global const double* restrict points,  // 3 rows
                     double loss_scale,
                     global double* restrict residuals,           // 2 rows of its slots, or NULL
                     global double* restrict tile_sums,           // cost, behind, singular, 0
                     local double* scratch) {
    const int tile = get_group_id(0);
    const int num_points = tile_num_points[tile];
    global const double* px = points + tile_points[tile];
    global const double* py = px + num_point_slots;
    global const double* pz = py + num_point_slots;
    double cost = 0, behind = 0, singular = 0;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const image_t image = load_image(images + IMAGE_RECORD * run_image[run]);
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const ushort* point = slot_point + first;
        global const double* observed = xy + 2 * (long)first;
#if WHITENED
        global const double* factor = whitening + 3 * (long)first;
#endif
        global double* out = residuals + 2 * (long)first;
        LANES(l, 0, n) {
            const int i = point[l];
            const view_t p = view(&image, px[i], py[i], pz[i]);
            const bool is_real = i < num_points;
            double rx, ry;
            camera_pixel(image.theta, p.u, p.v, &rx, &ry);
            rx -= observed[l];
            ry -= observed[n + l];
#if WHITENED
            ry = factor[n + l] * rx + factor[2 * n + l] * ry;
            rx = factor[l] * rx;
#endif
            rx = is_real ? rx : 0.0;
            ry = is_real ? ry : 0.0;
            double rho, slope;
            loss(rx * rx + ry * ry, loss_scale, &rho, &slope);
            cost += rho;
            behind += is_real && p.scale < 0 ? 1.0 : 0.0;
            singular += is_real && p.is_singular ? 1.0 : 0.0;
            if (residuals) {
                const double weight = sqrt(slope);
                out[l] = weight * rx;
                out[n + l] = weight * ry;
            }
        }
    }
    const double group_cost = GROUP_SUM(cost, scratch);
    const double group_behind = GROUP_SUM(behind, scratch);
    const double group_singular = GROUP_SUM(singular, scratch);
    if (IS_FIRST_LANE) {
        tile_sums[4 * tile] = 0.5 * group_cost;
        tile_sums[4 * tile + 1] = group_behind;
        tile_sums[4 * tile + 2] = group_singular;
        tile_sums[4 * tile + 3] = 0;
    }
}
