// SPDX-License-Identifier: Apache-2.0
// The stored Jacobian and the gradient: one work-group a tile of points.
// With A = d pixel / d P (2 x 3), whitened and multiplied by sqrt(rho'), the blocks of an
// observation are J_image = [-A [P]_x, A, d pixel / d theta] (2 x C) and J_point = A R (2 x 3), for
// the step R <- exp(w) R, t <- exp(w) t + v.
// Jacobian layout: run by run, 2 C + 6 rows of its slots: the first row of J_image, its second row,
// the first row of J_point, its second row. Padding slots hold 0.
// Writers: group t alone writes the blocks and partial sums of its runs, and its points' gradient.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "observation.clh"

#define COLUMNS (6 + CAMERA_PARAMS)

KERNEL void jacobian(global const int* restrict tile_points,
                     global const int* restrict tile_num_points,
                     global const int* restrict tile_runs, global const int* restrict run_image,
                     global const int* restrict run_slots,
                     global const ushort* restrict slot_point, global const double* restrict xy,
                     global const double* restrict whitening, global const double* restrict images,
                     int num_point_slots, global const double* restrict points, double loss_scale,
                     global REAL* restrict blocks,            // (2 COLUMNS + 6) a slot
                     global double* restrict run_gradient,    // COLUMNS a run
                     global double* restrict point_gradient,  // 3 rows of the point slots; added to
                     local double* scratch) {
    const int tile = get_group_id(0);
    const int num_points = tile_num_points[tile];
    global const double* px = points + tile_points[tile];
    global const double* py = px + num_point_slots;
    global const double* pz = py + num_point_slots;
    global double* gx = point_gradient + tile_points[tile];
    global double* gy = gx + num_point_slots;
    global double* gz = gy + num_point_slots;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const image_t image = load_image(images + IMAGE_RECORD * run_image[run]);
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const ushort* point = slot_point + first;
        global const double* observed = xy + 2 * (long)first;
#if WHITENED
        global const double* factor = whitening + 3 * (long)first;
#endif
        global REAL* out = blocks + (2 * COLUMNS + 6) * (long)first;
        double sum[COLUMNS];
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) sum[k] = 0;
        LANES_MEET();
        LANES(l, 0, n) {
            const int i = point[l];
            const view_t p = view(&image, px[i], py[i], pz[i]);
            const bool is_real = i < num_points;
            double rx, ry, d[4], b[2 * CAMERA_PARAMS];
            camera_pixel_derivatives(image.theta, p.u, p.v, &rx, &ry, d, b);
            rx -= observed[l];
            ry -= observed[n + l];
            // Rows of A, with d(u, v) / dP = scale [1, 0, -sign u; 0, 1, -sign v].
            double a0 = p.scale * d[0], a1 = p.scale * d[1];
            double a2 = -CAMERA_SIGN * p.scale * (d[0] * p.u + d[1] * p.v);
            double c0 = p.scale * d[2], c1 = p.scale * d[3];
            double c2 = -CAMERA_SIGN * p.scale * (d[2] * p.u + d[3] * p.v);
#if WHITENED
            const double l00 = factor[l], l10 = factor[n + l], l11 = factor[2 * n + l];
            ry = l10 * rx + l11 * ry;
            rx = l00 * rx;
            c0 = l10 * a0 + l11 * c0;
            c1 = l10 * a1 + l11 * c1;
            c2 = l10 * a2 + l11 * c2;
            a0 *= l00;
            a1 *= l00;
            a2 *= l00;
#pragma unroll
            for (int k = 0; k < CAMERA_PARAMS; ++k) {
                b[CAMERA_PARAMS + k] = l10 * b[k] + l11 * b[CAMERA_PARAMS + k];
                b[k] *= l00;
            }
#endif
            double rho, slope;
            loss(rx * rx + ry * ry, loss_scale, &rho, &slope);
            // The residual is zeroed too: where there is no derivative it adds no gradient.
            const double weight = is_real && !p.is_singular ? sqrt(slope) : 0.0;
            rx = is_real ? weight * rx : 0.0;
            ry = is_real ? weight * ry : 0.0;
            a0 *= weight;
            a1 *= weight;
            a2 *= weight;
            c0 *= weight;
            c1 *= weight;
            c2 *= weight;
            double row[COLUMNS], row2[COLUMNS];
            row[0] = p.y * a2 - p.z * a1;
            row[1] = p.z * a0 - p.x * a2;
            row[2] = p.x * a1 - p.y * a0;
            row[3] = a0;
            row[4] = a1;
            row[5] = a2;
            row2[0] = p.y * c2 - p.z * c1;
            row2[1] = p.z * c0 - p.x * c2;
            row2[2] = p.x * c1 - p.y * c0;
            row2[3] = c0;
            row2[4] = c1;
            row2[5] = c2;
#pragma unroll
            for (int k = 0; k < CAMERA_PARAMS; ++k) {
                row[6 + k] = weight * b[k];
                row2[6 + k] = weight * b[CAMERA_PARAMS + k];
            }
#pragma unroll
            for (int k = 0; k < COLUMNS; ++k) {
                out[k * n + l] = (REAL)row[k];
                out[(COLUMNS + k) * n + l] = (REAL)row2[k];
                sum[k] += row[k] * rx + row2[k] * ry;
            }
            const double e0 = a0 * image.r[0] + a1 * image.r[3] + a2 * image.r[6];
            const double e1 = a0 * image.r[1] + a1 * image.r[4] + a2 * image.r[7];
            const double e2 = a0 * image.r[2] + a1 * image.r[5] + a2 * image.r[8];
            const double h0 = c0 * image.r[0] + c1 * image.r[3] + c2 * image.r[6];
            const double h1 = c0 * image.r[1] + c1 * image.r[4] + c2 * image.r[7];
            const double h2 = c0 * image.r[2] + c1 * image.r[5] + c2 * image.r[8];
            out[2 * COLUMNS * n + l] = (REAL)e0;
            out[(2 * COLUMNS + 1) * n + l] = (REAL)e1;
            out[(2 * COLUMNS + 2) * n + l] = (REAL)e2;
            out[(2 * COLUMNS + 3) * n + l] = (REAL)h0;
            out[(2 * COLUMNS + 4) * n + l] = (REAL)h1;
            out[(2 * COLUMNS + 5) * n + l] = (REAL)h2;
            gx[i] += e0 * rx + h0 * ry;
            gy[i] += e1 * rx + h1 * ry;
            gz[i] += e2 * rx + h2 * ry;
        }
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) {
            const double total = GROUP_SUM(sum[k], scratch);
            if (IS_FIRST_LANE) run_gradient[COLUMNS * run + k] = total;
        }
    }
}
