// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "device/queue.hpp"

namespace clba {

// A vector of doubles in the tangent space, on the device: the F side (poses and intrinsics) and,
// unless only the reduced camera system is at work, 3 rows over the point slots of each chunk.
// Spare point slots hold 0.
struct Vector {
    Buffer f;
    std::vector<Buffer> e;

    size_t num_parts() const { return 1 + e.size(); }
    Buffer& part(size_t i) { return i == 0 ? f : e[i - 1]; }
    const Buffer& part(size_t i) const { return i == 0 ? f : e[i - 1]; }
    void fill_zero() {
        for (size_t i = 0; i < num_parts(); ++i) part(i).fill_zero();
    }
    void copy_from(const Vector& other) {
        for (size_t i = 0; i < num_parts(); ++i) part(i).copy_from(other.part(i));
    }
};

// Operations on vectors. Where one argument is reduced (F alone), the E side of the others is left
// out. Sums are deterministic: a fixed number of work-groups leaves partials that the host adds up
// in order.
class VectorOperations {
public:
    // real_type: "float" or "double", the REAL of the kernels.
    VectorOperations(Queue& queue, const std::string& real_type);

    double dot(const Vector& x, const Vector& y);
    double squared_norm(const Buffer& x);                   // of doubles
    double squared_norm(const std::vector<Buffer>& reals);  // of REALs, all buffers together
    double max_abs(const Vector& x);                        // infinite if one is NaN
    void scale_and_add(double a, const Vector& x, double b, Vector& y);  // y = a x + b y
    void add_damping(double lambda, const Vector& d2, const Vector& x, Vector& y);
    // x += alpha p, r -= alpha q; returns x . (b + r).
    double pcg_step(double alpha, const Vector& p, const Vector& q, const Vector& b, Vector& x,
                    Vector& r);
    void to_real(const Buffer& x, Buffer& y);    // doubles to REAL
    void from_real(const Buffer& x, Buffer& y);  // REAL to doubles
    void mask_constants(const Buffer& scale, Buffer& x);

private:
    Kernel& kernel(const char* name);
    int64_t num_groups(int64_t n) const;
    // Partials of all parts of a vector like x, each launched by launch(part, groups, first
    // partial).
    template <class Launch>
    const std::vector<double>& partials(const Vector& x, Launch&& launch);
    void reserve_partials(size_t num_parts);
    const std::vector<double>& read_partials(int64_t count);

    Queue& queue_;
    std::string defines_;
    size_t real_bytes_;
    Buffer partials_;
    std::vector<double> host_partials_;
};

}  // namespace clba
