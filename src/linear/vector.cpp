// SPDX-License-Identifier: Apache-2.0
#include "linear/vector.hpp"

#include <algorithm>
#include <numeric>

namespace clba {
namespace {

int32_t num_doubles(const Buffer& x) {
    return static_cast<int32_t>(x.bytes() / sizeof(double));
}

constexpr int64_t elements_per_group = 1024;  // fewer are not worth a group

}  // namespace

VectorOperations::VectorOperations(Queue& queue, const std::string& real_type)
    : queue_(queue),
      defines_("-DREAL=" + real_type),
      real_bytes_(real_type == "double" ? sizeof(double) : sizeof(float)) {}

Kernel& VectorOperations::kernel(const char* name) {
    return queue_.kernel("vector.cl", name, defines_);
}

int64_t VectorOperations::num_groups(int64_t n) const {
    const int64_t wanted = (n + elements_per_group - 1) / elements_per_group;
    return std::min<int64_t>(queue_.tuning().vector_groups, wanted);
}

void VectorOperations::reserve_partials(size_t num_parts) {
    const size_t bytes =
        num_parts * static_cast<size_t>(queue_.tuning().vector_groups) * sizeof(double);
    if (partials_.bytes() < bytes) partials_ = Buffer(queue_, bytes, "partial sums");
}

const std::vector<double>& VectorOperations::read_partials(int64_t count) {
    host_partials_.resize(static_cast<size_t>(count));
    partials_.read(host_partials_.data(), host_partials_.size() * sizeof(double));
    return host_partials_;
}

template <class Launch>
const std::vector<double>& VectorOperations::partials(const Vector& x, Launch&& launch) {
    reserve_partials(x.num_parts());
    int32_t num_partials = 0;
    for (size_t i = 0; i < x.num_parts(); ++i) {
        const int64_t groups = num_groups(num_doubles(x.part(i)));
        launch(i, groups, num_partials);
        num_partials += static_cast<int32_t>(groups);
    }
    return read_partials(num_partials);
}

double VectorOperations::dot(const Vector& x, const Vector& y) {
    const auto& sums = partials(x, [&](size_t i, int64_t groups, int32_t first) {
        queue_.launch(Step::vector, kernel("dot_product"), groups, num_doubles(x.part(i)),
                      x.part(i), y.part(i), first, partials_, queue_.scratch());
    });
    return std::accumulate(sums.begin(), sums.end(), 0.0);
}

double VectorOperations::squared_norm(const Buffer& x) {
    reserve_partials(1);
    const int64_t groups = num_groups(num_doubles(x));
    queue_.launch(Step::vector, kernel("dot_product"), groups, num_doubles(x), x, x, 0, partials_,
                  queue_.scratch());
    const auto& sums = read_partials(groups);
    return std::accumulate(sums.begin(), sums.end(), 0.0);
}

double VectorOperations::squared_norm(const std::vector<Buffer>& reals) {
    reserve_partials(reals.size());
    int64_t num_partials = 0;
    for (const Buffer& x : reals) {
        const auto n = static_cast<int32_t>(x.bytes() / real_bytes_);
        const int64_t groups = num_groups(n);
        queue_.launch(Step::vector, kernel("squared_norm"), groups, n, x,
                      static_cast<int32_t>(num_partials), partials_, queue_.scratch());
        num_partials += groups;
    }
    const auto& sums = read_partials(num_partials);
    return std::accumulate(sums.begin(), sums.end(), 0.0);
}

double VectorOperations::max_abs(const Vector& x) {
    const auto& largest = partials(x, [&](size_t i, int64_t groups, int32_t first) {
        queue_.launch(Step::vector, kernel("max_abs"), groups, num_doubles(x.part(i)), x.part(i),
                      first, partials_, queue_.scratch());
    });
    return largest.empty() ? 0.0 : *std::max_element(largest.begin(), largest.end());
}

void VectorOperations::scale_and_add(double a, const Vector& x, double b, Vector& y) {
    for (size_t i = 0; i < y.num_parts(); ++i)
        queue_.launch(Step::vector, kernel("scale_and_add"), num_groups(num_doubles(y.part(i))),
                      num_doubles(y.part(i)), a, x.part(i), b, y.part(i));
}

void VectorOperations::add_damping(double lambda, const Vector& d2, const Vector& x, Vector& y) {
    for (size_t i = 0; i < y.num_parts(); ++i)
        queue_.launch(Step::vector, kernel("add_damping"), num_groups(num_doubles(y.part(i))),
                      num_doubles(y.part(i)), lambda, d2.part(i), x.part(i), y.part(i));
}

double VectorOperations::pcg_step(double alpha, const Vector& p, const Vector& q, const Vector& b,
                                  Vector& x, Vector& r) {
    const auto& sums = partials(p, [&](size_t i, int64_t groups, int32_t first) {
        queue_.launch(Step::vector, kernel("pcg_step"), groups, num_doubles(p.part(i)), alpha,
                      p.part(i), q.part(i), b.part(i), x.part(i), r.part(i), first, partials_,
                      queue_.scratch());
    });
    return std::accumulate(sums.begin(), sums.end(), 0.0);
}

void VectorOperations::to_real(const Buffer& x, Buffer& y) {
    queue_.launch(Step::vector, kernel("to_real"), num_groups(num_doubles(x)), num_doubles(x), x,
                  y);
}

void VectorOperations::from_real(const Buffer& x, Buffer& y) {
    queue_.launch(Step::vector, kernel("from_real"), num_groups(num_doubles(y)), num_doubles(y), x,
                  y);
}

void VectorOperations::mask_constants(const Buffer& scale, Buffer& x) {
    queue_.launch(Step::vector, kernel("mask_constants"), num_groups(num_doubles(x)),
                  num_doubles(x), scale, x);
}

}  // namespace clba
