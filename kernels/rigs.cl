// SPDX-License-Identifier: Apache-2.0
// Rigs: images whose pose is R_i = R_s R_f, t_i = R_s t_f + t_s of a sensor s and a frame f. Their
// tangents are those of parameters by the linear map T,
//   w_i = R_s w_f + w_s,  v_i = R_s v_f + t_s x R_s w_f + v_s,
// and the rest of an F vector is the same in both, at other places. Image i of n is the i-th of these
// images, which are in the order of their frames. Vectors of images are `of_images`.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "positions.clh"
#include "poses.clh"
#define SENSOR_RECORD 12  // R row-major, t

static inline void turn(global const WIDE* r, const WIDE* x, WIDE* y) {
    for (int k = 0; k < 3; ++k) y[k] = r[3 * k] * x[0] + r[3 * k + 1] * x[1] + r[3 * k + 2] * x[2];
}

static inline void turn_back(global const WIDE* r, const WIDE* x, WIDE* y) {
    for (int k = 0; k < 3; ++k) y[k] = r[k] * x[0] + r[3 + k] * x[1] + r[6 + k] * x[2];
}

// Writers: one sensor each.
KERNEL void sensor_records(int num_sensors, global const WIDE* restrict sensors,
                           global WIDE* restrict records) {
    const int end = share_end(num_sensors);
    LANES_UNVECTORIZED(s, share_begin(num_sensors), end) {
        global const WIDE* pose = sensors + POSE_VALUES * s;
        WIDE r[9];
        rotation_of(pose, r);
        global WIDE* out = records + SENSOR_RECORD * s;
        for (int k = 0; k < 9; ++k) out[k] = r[k];
        for (int k = 0; k < 3; ++k) {
#ifdef NO_DOUBLE
            const WIDE x = pose[4] + pose[7], y = pose[5] + pose[8], z = pose[6] + pose[9];
            out[9 + k] = -(r[3 * k] * x + r[3 * k + 1] * y + r[3 * k + 2] * z);
#else
            out[9 + k] = pose[4 + k];
#endif
        }
    }
}

// Poses of images by those of their frames and sensors; with NO_DOUBLE C_i = C_f + R_f^T C_s.
// Writers: one image each.
KERNEL void compose_images(int n, global const int* restrict images,
                           global const int* restrict image_frame,
                           global const int* restrict image_sensor,
                           global const WIDE* restrict frames,
                           global const WIDE* restrict sensors, global WIDE* restrict poses) {
    const int end = share_end(n);
    LANES_UNVECTORIZED(i, share_begin(n), end) {
        global const WIDE* f = frames + POSE_VALUES * image_frame[i];
        global const WIDE* s = sensors + POSE_VALUES * image_sensor[i];
        global WIDE* out = poses + POSE_VALUES * images[i];
        out[0] = s[0] * f[0] - s[1] * f[1] - s[2] * f[2] - s[3] * f[3];
        out[1] = s[0] * f[1] + s[1] * f[0] + s[2] * f[3] - s[3] * f[2];
        out[2] = s[0] * f[2] - s[1] * f[3] + s[2] * f[0] + s[3] * f[1];
        out[3] = s[0] * f[3] + s[1] * f[2] - s[2] * f[1] + s[3] * f[0];
        WIDE r[9];
#ifdef NO_DOUBLE
        rotation_of(f, r);
        const WIDE x = s[4] + s[7], y = s[5] + s[8], z = s[6] + s[9];
        for (int k = 0; k < 3; ++k)
            move_position(f, out, 4 + k, 3, r[k] * x + r[3 + k] * y + r[6 + k] * z);
#else
        rotation_of(s, r);
        for (int k = 0; k < 3; ++k)
            out[4 + k] = r[3 * k] * f[4] + r[3 * k + 1] * f[5] + r[3 * k + 2] * f[6] + s[4 + k];
#endif
    }
}

// y[to] = x[from], or y[to] += x[from]; no target twice.
// Writers: one number each.
KERNEL void move_values(int n, global const int* restrict from, global const int* restrict to,
                        int is_added, global const WIDE* restrict x, global WIDE* restrict y) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(k, begin, end) y[to[k]] = (is_added ? y[to[k]] : (WIDE)0) + x[from[k]];
}

// of_images = T x, of poses.
// Writers: one image each.
KERNEL void expand_poses(int n, global const int* restrict image_offset,
                         global const int* restrict frame_offset,
                         global const int* restrict sensor_offset,
                         global const int* restrict image_sensor,
                         global const WIDE* restrict records, global const WIDE* restrict x,
                         global WIDE* restrict of_images) {
    const int end = share_end(n);
    LANES_UNVECTORIZED(i, share_begin(n), end) {
        global const WIDE* record = records + SENSOR_RECORD * image_sensor[i];
        global const WIDE* f = x + frame_offset[i];
        global const WIDE* s = x + sensor_offset[i];
        global const WIDE* t = record + 9;
        const WIDE of_frame[6] = {f[0], f[1], f[2], f[3], f[4], f[5]};
        WIDE w[3], v[3];
        turn(record, of_frame, w);
        turn(record, of_frame + 3, v);
        global WIDE* out = of_images + image_offset[i];
        out[0] = w[0] + s[0];
        out[1] = w[1] + s[1];
        out[2] = w[2] + s[2];
        out[3] = v[0] + t[1] * w[2] - t[2] * w[1] + s[3];
        out[4] = v[1] + t[2] * w[0] - t[0] * w[2] + s[4];
        out[5] = v[2] + t[0] * w[1] - t[1] * w[0] + s[5];
    }
}

// x += T^T of_images, of frames: w_f = R_s^T (w_i - t_s x v_i), v_f = R_s^T v_i, image by image.
// Writers: one frame each.
KERNEL void gather_frames(int num_frames, global const int* restrict frame_images,
                          global const int* restrict frame_offset,
                          global const int* restrict image_offset,
                          global const int* restrict image_sensor,
                          global const WIDE* restrict records,
                          global const WIDE* restrict of_images, global WIDE* restrict x) {
    const int end = share_end(num_frames);
    LANES_UNVECTORIZED(frame, share_begin(num_frames), end) {
        WIDE sum[6] = {0, 0, 0, 0, 0, 0};
        for (int i = frame_images[frame]; i < frame_images[frame + 1]; ++i) {
            global const WIDE* record = records + SENSOR_RECORD * image_sensor[i];
            global const WIDE* t = record + 9;
            global const WIDE* in = of_images + image_offset[i];
            const WIDE v[3] = {in[3], in[4], in[5]};
            const WIDE w[3] = {in[0] - (t[1] * v[2] - t[2] * v[1]),
                               in[1] - (t[2] * v[0] - t[0] * v[2]),
                               in[2] - (t[0] * v[1] - t[1] * v[0])};
            WIDE turned[6];
            turn_back(record, w, turned);
            turn_back(record, v, turned + 3);
            for (int k = 0; k < 6; ++k) sum[k] += turned[k];
        }
        global WIDE* out = x + frame_offset[frame_images[frame]];
        for (int k = 0; k < 6; ++k) out[k] += sum[k];
    }
}

// out += the sum over the images of a sensor of SENSOR_VALUES numbers from image_first, as of
// vectors (6 of a pose) or of packed triangles (21, with a pose's rows first).
// Writers: group s alone writes the numbers of sensor s from sensor_first.
#ifndef SENSOR_VALUES
#define SENSOR_VALUES 6
#endif
KERNEL void gather_sensors(global const int* restrict sensor_images,  // first of each, and end
                           global const int* restrict images_by_sensor,
                           global const int* restrict sensor_first,
                           global const int* restrict image_first,
                           global const WIDE* restrict of_images, global WIDE* restrict out,
                           local WIDE* scratch) {
    const int s = get_group_id(0);
    WIDE sum[SENSOR_VALUES];
    for (int k = 0; k < SENSOR_VALUES; ++k) sum[k] = 0;
    LANES_UNVECTORIZED(j, sensor_images[s], sensor_images[s + 1]) {
        global const WIDE* in = of_images + image_first[images_by_sensor[j]];
        for (int k = 0; k < SENSOR_VALUES; ++k) sum[k] += in[k];
    }
    for (int k = 0; k < SENSOR_VALUES; ++k) {
        const WIDE total = GROUP_SUM(sum[k], scratch);
        if (IS_FIRST_LANE) out[sensor_first[s] + k] += total;
    }
}

// Diagonal blocks of frames, packed lower triangles: sum over their images of A^T B A, with B the
// pose's part of the image's block, A = [R, 0; [t]_x R, R] of its sensor.
// Writers: one frame each.
KERNEL void frame_blocks(int num_frames, global const int* restrict frame_images,
                         global const int* restrict frame_matrix,
                         global const int* restrict image_matrix,
                         global const int* restrict image_sensor,
                         global const WIDE* restrict records,
                         global const WIDE* restrict of_images, global WIDE* restrict matrices) {
    const int end = share_end(num_frames);
    LANES_UNVECTORIZED(frame, share_begin(num_frames), end) {
        WIDE sum[21];
        for (int k = 0; k < 21; ++k) sum[k] = 0;
        for (int i = frame_images[frame]; i < frame_images[frame + 1]; ++i) {
            global const WIDE* record = records + SENSOR_RECORD * image_sensor[i];
            global const WIDE* b = of_images + image_matrix[i];
            const WIDE tx = record[9], ty = record[10], tz = record[11];
            WIDE a[36], product[36];  // A, B A
            for (int c = 0; c < 3; ++c) {
                const WIDE x = record[c], y = record[3 + c], z = record[6 + c];
                a[c] = a[21 + c] = x;
                a[6 + c] = a[27 + c] = y;
                a[12 + c] = a[33 + c] = z;
                a[18 + c] = ty * z - tz * y;
                a[24 + c] = tz * x - tx * z;
                a[30 + c] = tx * y - ty * x;
                a[3 + c] = a[9 + c] = a[15 + c] = 0;
            }
            for (int r = 0; r < 6; ++r) {
                for (int c = 0; c < 6; ++c) {
                    WIDE value = 0;
                    for (int k = 0; k < 6; ++k)
                        value += b[k <= r ? r * (r + 1) / 2 + k : k * (k + 1) / 2 + r] * a[6 * k + c];
                    product[6 * r + c] = value;
                }
            }
            for (int r = 0; r < 6; ++r)
                for (int c = 0; c <= r; ++c)
                    for (int k = 0; k < 6; ++k)
                        sum[r * (r + 1) / 2 + c] += a[6 * k + r] * product[6 * k + c];
        }
        global WIDE* out = matrices + frame_matrix[frame];
        for (int k = 0; k < 21; ++k) out[k] = sum[k];
    }
}
