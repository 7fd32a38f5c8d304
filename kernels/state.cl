// SPDX-License-Identifier: Apache-2.0
// The state and its update on the manifold: R <- exp(w) R, t <- exp(w) t + v, the rest is added.
// Poses are 7 numbers an image (quaternion w x y z, translation), camera parameters MAX_CAMERA_PARAMS
// a camera, points 3 rows. With NO_DOUBLE a pose is the quaternion and the camera centre C = -R^T t,
// high parts, then low parts (positions.clh), 10 numbers; points are 3 rows of each part; and as
// t <- exp(w) t + v is C <- C - R^T v with the R after the step, no rotation moves a centre.
// Writers: one image, camera or element each.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "tiles.clh"
#include "positions.clh"
#include "poses.clh"

// What kernels over observations read of an image (tiles.clh).
KERNEL void image_records(int num_images, global const WIDE* restrict poses,
                          global const int* restrict image_camera,
                          global const WIDE* restrict camera_params,
                          global WIDE* restrict records) {
    const int end = share_end(num_images);
    LANES(i, share_begin(num_images), end) {
        global const WIDE* pose = poses + POSE_VALUES * i;
        global WIDE* out = records + IMAGE_RECORD * i;
        WIDE r[9];
        rotation_of(pose, r);
#pragma unroll
        for (int k = 0; k < 9; ++k) out[k] = r[k];
        out[9] = pose[4];
        out[10] = pose[5];
        out[11] = pose[6];
        global const WIDE* params = camera_params + MAX_CAMERA_PARAMS * image_camera[i];
#pragma unroll
        for (int k = 0; k < MAX_CAMERA_PARAMS; ++k) out[12 + k] = params[k];
#ifdef NO_DOUBLE
#pragma unroll
        for (int k = 0; k < 3; ++k) out[12 + MAX_CAMERA_PARAMS + k] = pose[7 + k];
#endif
    }
}

// Constant parameters have a step of 0.
KERNEL void update_images(int num_images, global const int* restrict pose_offsets,
                          global const WIDE* restrict step, global const WIDE* restrict poses,
                          global WIDE* restrict updated) {
    const int end = share_end(num_images);
    LANES(i, share_begin(num_images), end) {
        global const WIDE* d = step + pose_offsets[i];
        global const WIDE* pose = poses + POSE_VALUES * i;
        global WIDE* out = updated + POSE_VALUES * i;
        const WIDE wx = d[0], wy = d[1], wz = d[2];
        const WIDE angle2 = wx * wx + wy * wy + wz * wz;
        const WIDE angle = sqrt(angle2);
        // Quaternion (c, s w) of exp(w); the Taylor series where sin(a / 2) / a loses digits.
        const WIDE s = angle < (WIDE)1e-4 ? (WIDE)0.5 - angle2 / 48 : sin((WIDE)0.5 * angle) / angle;
        const WIDE c = cos((WIDE)0.5 * angle);
        const WIDE ax = s * wx, ay = s * wy, az = s * wz;
        const WIDE bw = pose[0], bx = pose[1], by = pose[2], bz = pose[3];
        const WIDE qw = c * bw - ax * bx - ay * by - az * bz;
        const WIDE qx = c * bx + ax * bw + ay * bz - az * by;
        const WIDE qy = c * by - ax * bz + ay * bw + az * bx;
        const WIDE qz = c * bz + ax * by - ay * bx + az * bw;
        const WIDE norm = 1 / sqrt(qw * qw + qx * qx + qy * qy + qz * qz);
        // A constant rotation keeps its bits.
        const WIDE w = angle2 > 0 ? norm * qw : bw, x = angle2 > 0 ? norm * qx : bx;
        const WIDE y = angle2 > 0 ? norm * qy : by, z = angle2 > 0 ? norm * qz : bz;
        out[0] = w;
        out[1] = x;
        out[2] = y;
        out[3] = z;
#ifdef NO_DOUBLE
        const WIDE vx = d[3], vy = d[4], vz = d[5];
        // R^T v = v - 2 w (q x v) + 2 q x (q x v) with q = (x, y, z).
        const WIDE ux = 2 * (y * vz - z * vy);
        const WIDE uy = 2 * (z * vx - x * vz);
        const WIDE uz = 2 * (x * vy - y * vx);
        move_position(pose, out, 4, 3, w * ux - (y * uz - z * uy) - vx);
        move_position(pose, out, 5, 3, w * uy - (z * ux - x * uz) - vy);
        move_position(pose, out, 6, 3, w * uz - (x * uy - y * ux) - vz);
#else
        const WIDE tx = pose[4], ty = pose[5], tz = pose[6];
        // exp(w) t = t + 2 c (a x t) + 2 a x (a x t) with a = (ax, ay, az).
        const WIDE ux = 2 * (ay * tz - az * ty);
        const WIDE uy = 2 * (az * tx - ax * tz);
        const WIDE uz = 2 * (ax * ty - ay * tx);
        out[4] = tx + c * ux + (ay * uz - az * uy) + d[3];
        out[5] = ty + c * uy + (az * ux - ax * uz) + d[4];
        out[6] = tz + c * uz + (ax * uy - ay * ux) + d[5];
#endif
    }
}

KERNEL void update_cameras(int num_cameras, global const int* restrict intrinsics_offsets,
                           global const int* restrict num_params,
                           global const WIDE* restrict step,
                           global const WIDE* restrict params,
                           global WIDE* restrict updated) {
    const int end = share_end(num_cameras);
    LANES(i, share_begin(num_cameras), end) {
#pragma unroll
        for (int k = 0; k < MAX_CAMERA_PARAMS; ++k) {
            const int at = MAX_CAMERA_PARAMS * i + k;
            const bool is_used = k < num_params[i];
            const WIDE moved = params[at] + step[intrinsics_offsets[i] + (is_used ? k : 0)];
            updated[at] = is_used ? moved : params[at];
        }
    }
}

// updated = points + step, 3 rows as one vector of n (with NO_DOUBLE two, of high and low parts).
KERNEL void update_points(int n, global const WIDE* restrict step,
                          global const WIDE* restrict points,
                          global WIDE* restrict updated) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) move_position(points, updated, i, n, step[i]);
}
