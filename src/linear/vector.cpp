// SPDX-License-Identifier: Apache-2.0
#include "linear/vector.hpp"

#include <algorithm>
#include <numeric>
#include <type_traits>

namespace clba {
namespace {

constexpr int64_t elements_per_group = 1024;  // fewer are not worth a group

}  // namespace

VectorOperations::VectorOperations(Queue& queue, Precision precision)
    : queue_(queue), precision_(precision), defines_(precision_defines(precision)) {}

int32_t VectorOperations::num_values(const Buffer& wides) const {
    return static_cast<int32_t>(wides.bytes() / wide_bytes(precision_));
}

int32_t VectorOperations::num_partials(const Vector& x) const {
    int32_t count = 0;
    for_each_part(x, [&](size_t, int64_t groups, int32_t first) {
        count = first + static_cast<int32_t>(groups);
    });
    return count;
}

int32_t VectorOperations::dot_partials(const Vector& x, const Vector& y, Buffer& partials,
                                       int32_t first_partial) {
    int32_t count = 0;
    for_each_part(x, [&](size_t i, int64_t groups, int32_t first) {
        queue_.launch(Step::vector, kernel("dot_product"), groups, num_values(x.part(i)), x.part(i),
                      y.part(i), first_partial + first, partials, queue_.scratch());
        count = first + static_cast<int32_t>(groups);
    });
    return count;
}

Kernel& VectorOperations::kernel(const char* name) {
    return queue_.kernel("vector.cl", name, defines_);
}

int64_t VectorOperations::num_groups(int64_t n) const {
    const int64_t wanted = (n + elements_per_group - 1) / elements_per_group;
    return std::min<int64_t>(queue_.tuning().vector_groups, wanted);
}

void VectorOperations::reserve_partials(size_t num_parts) {
    const size_t bytes =
        num_parts * static_cast<size_t>(queue_.tuning().vector_groups) * wide_bytes(precision_);
    if (partials_.bytes() < bytes) partials_ = Buffer(queue_, bytes, "partial sums");
}

const std::vector<double>& VectorOperations::read_partials(int64_t count) {
    host_partials_.resize(static_cast<size_t>(count));
    read_wide(partials_, host_partials_, host_partials_.size());
    return host_partials_;
}

void VectorOperations::read_wide(const Buffer& buffer, std::vector<double>& values,
                                 size_t n) const {
    with_wide(precision_, [&](auto wide) {
        using Wide = decltype(wide);
        if constexpr (std::is_same_v<Wide, double>) {
            buffer.read(values.data(), n * sizeof(double));
        } else {
            std::vector<Wide> read(n);
            buffer.read(read.data(), n * sizeof(Wide));
            std::copy(read.begin(), read.end(), values.begin());
        }
    });
}

double VectorOperations::dot(const Vector& x, const Vector& y) {
    reserve_partials(x.num_parts());
    const auto& sums = read_partials(dot_partials(x, y, partials_));
    return std::accumulate(sums.begin(), sums.end(), 0.0);
}

double VectorOperations::squared_norm(const Buffer& x) {
    reserve_partials(1);
    const int64_t groups = num_groups(num_values(x));
    queue_.launch(Step::vector, kernel("dot_product"), groups, num_values(x), x, x, 0, partials_,
                  queue_.scratch());
    const auto& sums = read_partials(groups);
    return std::accumulate(sums.begin(), sums.end(), 0.0);
}

double VectorOperations::squared_norm(const std::vector<Buffer>& reals) {
    reserve_partials(reals.size());
    int64_t num_partials = 0;
    for (const Buffer& x : reals) {
        const auto n = static_cast<int32_t>(x.bytes() / real_bytes(precision_));
        const int64_t groups = num_groups(n);
        queue_.launch(Step::vector, kernel("squared_norm"), groups, n, x,
                      static_cast<int32_t>(num_partials), partials_, queue_.scratch());
        num_partials += groups;
    }
    const auto& sums = read_partials(num_partials);
    return std::accumulate(sums.begin(), sums.end(), 0.0);
}

double VectorOperations::max_abs(const Vector& x) {
    reserve_partials(x.num_parts());
    for_each_part(x, [&](size_t i, int64_t groups, int32_t first) {
        queue_.launch(Step::vector, kernel("max_abs"), groups, num_values(x.part(i)), x.part(i),
                      first, partials_, queue_.scratch());
    });
    const auto& largest = read_partials(num_partials(x));
    return largest.empty() ? 0.0 : *std::max_element(largest.begin(), largest.end());
}

void VectorOperations::scale_and_add(double a, const Vector& x, double b, Vector& y) {
    for (size_t i = 0; i < y.num_parts(); ++i)
        queue_.launch(Step::vector, kernel("scale_and_add"), num_groups(num_values(y.part(i))),
                      num_values(y.part(i)), a, x.part(i), b, y.part(i));
}

void VectorOperations::to_real(const Buffer& x, Buffer& y) {
    queue_.launch(Step::vector, kernel("to_real"), num_groups(num_values(x)), num_values(x), x, y);
}

void VectorOperations::from_real(const Buffer& x, Buffer& y) {
    queue_.launch(Step::vector, kernel("from_real"), num_groups(num_values(y)), num_values(y), x, 0,
                  y);
}

void VectorOperations::add_real(const Buffer& x, Buffer& y) {
    queue_.launch(Step::vector, kernel("from_real"), num_groups(num_values(y)), num_values(y), x, 1,
                  y);
}

void VectorOperations::mask_constants(const Buffer& scale, Buffer& x) {
    queue_.launch(Step::vector, kernel("mask_constants"), num_groups(num_values(x)), num_values(x),
                  scale, x);
}

}  // namespace clba
