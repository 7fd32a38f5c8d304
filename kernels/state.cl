// SPDX-License-Identifier: Apache-2.0
// The state and its update on the manifold: R <- exp(w) R, t <- exp(w) t + v, the rest is added.
// Poses are 7 doubles an image (quaternion w x y z, translation), camera parameters MAX_CAMERA_PARAMS
// a camera, points 3 rows. Writers: one image, camera or element each.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "tiles.clh"


// What kernels over observations read of an image: R row-major, t, intrinsics.
KERNEL void image_records(int num_images, global const WIDE* restrict poses,
                          global const int* restrict image_camera,
                          global const WIDE* restrict camera_params,
                          global WIDE* restrict records) {
    const int end = share_end(num_images);
    LANES(i, share_begin(num_images), end) {
        global const WIDE* pose = poses + 7 * i;
        const WIDE w = pose[0], x = pose[1], y = pose[2], z = pose[3];
        global WIDE* out = records + IMAGE_RECORD * i;
        out[0] = 1 - 2 * (y * y + z * z);
        out[1] = 2 * (x * y - w * z);
        out[2] = 2 * (x * z + w * y);
        out[3] = 2 * (x * y + w * z);
        out[4] = 1 - 2 * (x * x + z * z);
        out[5] = 2 * (y * z - w * x);
        out[6] = 2 * (x * z - w * y);
        out[7] = 2 * (y * z + w * x);
        out[8] = 1 - 2 * (x * x + y * y);
        out[9] = pose[4];
        out[10] = pose[5];
        out[11] = pose[6];
        global const WIDE* params = camera_params + MAX_CAMERA_PARAMS * image_camera[i];
#pragma unroll
        for (int k = 0; k < MAX_CAMERA_PARAMS; ++k) out[12 + k] = params[k];
    }
}

// Constant parameters have a step of 0.
KERNEL void update_images(int num_images, global const int* restrict pose_offsets,
                          global const WIDE* restrict step, global const WIDE* restrict poses,
                          global WIDE* restrict updated) {
    const int end = share_end(num_images);
    LANES(i, share_begin(num_images), end) {
        global const WIDE* d = step + pose_offsets[i];
        global const WIDE* pose = poses + 7 * i;
        global WIDE* out = updated + 7 * i;
        const WIDE wx = d[0], wy = d[1], wz = d[2];
        const WIDE angle2 = wx * wx + wy * wy + wz * wz;
        const WIDE angle = sqrt(angle2);
        // Quaternion (c, s w) of exp(w); the Taylor series where sin(a / 2) / a loses digits.
        const WIDE s = angle < 1e-4 ? 0.5 - angle2 / 48 : sin(0.5 * angle) / angle;
        const WIDE c = cos(0.5 * angle);
        const WIDE ax = s * wx, ay = s * wy, az = s * wz;
        const WIDE bw = pose[0], bx = pose[1], by = pose[2], bz = pose[3];
        const WIDE qw = c * bw - ax * bx - ay * by - az * bz;
        const WIDE qx = c * bx + ax * bw + ay * bz - az * by;
        const WIDE qy = c * by - ax * bz + ay * bw + az * bx;
        const WIDE qz = c * bz + ax * by - ay * bx + az * bw;
        const WIDE norm = 1 / sqrt(qw * qw + qx * qx + qy * qy + qz * qz);
        // A constant rotation keeps its bits.
        out[0] = angle2 > 0 ? norm * qw : bw;
        out[1] = angle2 > 0 ? norm * qx : bx;
        out[2] = angle2 > 0 ? norm * qy : by;
        out[3] = angle2 > 0 ? norm * qz : bz;
        const WIDE tx = pose[4], ty = pose[5], tz = pose[6];
        // exp(w) t = t + 2 c (a x t) + 2 a x (a x t) with a = (ax, ay, az).
        const WIDE ux = 2 * (ay * tz - az * ty);
        const WIDE uy = 2 * (az * tx - ax * tz);
        const WIDE uz = 2 * (ax * ty - ay * tx);
        out[4] = tx + c * ux + (ay * uz - az * uy) + d[3];
        out[5] = ty + c * uy + (az * ux - ax * uz) + d[4];
        out[6] = tz + c * uz + (ax * uy - ay * ux) + d[5];
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
            updated[at] = params[at];
            if (k < num_params[i]) updated[at] += step[intrinsics_offsets[i] + k];
        }
    }
}

// updated = points + step, 3 rows as one vector of n.
KERNEL void update_points(int n, global const WIDE* restrict step,
                          global const WIDE* restrict points,
                          global WIDE* restrict updated) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(i, begin, end) updated[i] = points[i] + step[i];
}
