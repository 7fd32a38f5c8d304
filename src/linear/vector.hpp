// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "device/queue.hpp"
#include "linear/precision.hpp"

namespace clba {

// A vector of WIDEs in the tangent space, on the device: the F side (poses and intrinsics) and,
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
    VectorOperations(Queue& queue, Precision precision);

    double dot(const Vector& x, const Vector& y);
    double squared_norm(const Buffer& x);                   // of WIDEs
    double squared_norm(const std::vector<Buffer>& reals);  // of REALs, all buffers together
    double max_abs(const Vector& x);                        // infinite if one is NaN
    void scale_and_add(double a, const Vector& x, double b, Vector& y);  // y = a x + b y
    // x . y as partials on the device, from first_partial; returns how many.
    int32_t dot_partials(const Vector& x, const Vector& y, Buffer& partials,
                         int32_t first_partial = 0);
    // As many as dot_partials leaves for vectors like x.
    int32_t num_partials(const Vector& x) const;
    // visit(part, work-groups, first partial) for each part of vectors like x.
    template <class Visit>
    void for_each_part(const Vector& x, Visit&& visit) const {
        int32_t first_partial = 0;
        for (size_t i = 0; i < x.num_parts(); ++i) {
            const int64_t groups = num_groups(num_values(x.part(i)));
            visit(i, groups, first_partial);
            first_partial += static_cast<int32_t>(groups);
        }
    }
    int32_t num_values(const Buffer& wides) const;
    const std::string& defines() const { return defines_; }
    // The first n WIDEs of a buffer.
    void read_wide(const Buffer& buffer, std::vector<double>& values, size_t n) const;
    Precision precision() const { return precision_; }
    void to_real(const Buffer& x, Buffer& y);    // WIDE to REAL
    void from_real(const Buffer& x, Buffer& y);  // REAL to WIDE
    void add_real(const Buffer& x, Buffer& y);   // y += x, REAL to WIDE
    void mask_constants(const Buffer& scale, Buffer& x);

private:
    Kernel& kernel(const char* name);
    int64_t num_groups(int64_t n) const;
    void reserve_partials(size_t num_parts);
    const std::vector<double>& read_partials(int64_t count);

    Queue& queue_;
    Precision precision_;
    std::string defines_;
    Buffer partials_;
    std::vector<double> host_partials_;
};

}  // namespace clba
