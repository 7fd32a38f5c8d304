// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>

#include "linear/dense_kernels.hpp"
#include "linear/worker_pool.hpp"

namespace clba {

// What dense operations on a front run on. pool nullptr: on the calling thread alone, with the
// workspace of that worker. The results are the same.
template <class Real>
struct DenseThreads {
    const DenseKernels<Real>* kernels;
    WorkerPool* pool;
    Real* workspaces;  // kernel_workspace_size numbers for each worker
    int worker;

    Real* workspace(int of_worker) const { return workspaces + of_worker * kernel_workspace_size; }
    // task(index, worker), in any order.
    template <class Task>
    void run(int64_t count, bool large, const Task& task) const {
        if (pool && large) return pool->run(count, task);
        for (int64_t index = 0; index < count; ++index) task(index, worker);
    }
};

// The first p columns of the front's m rows become L (m x p) and its update matrix, of which only
// the lower triangle counts, loses L2 L2^T, with L2 the rows from p. False: not positive definite.
template <class Real>
bool partial_factor(const FrontTarget<Real>& front, int64_t m, const DenseThreads<Real>& threads);

// The same on the pool as kernels.solve_forward and solve_backward of L, m x n.
template <class Real>
void solve_forward(const Real* l, int64_t stride, int64_t m, int64_t n, Real* y,
                   const DenseThreads<Real>& threads);
template <class Real>
void solve_backward(const Real* l, int64_t stride, int64_t m, int64_t n, Real* y,
                    const DenseThreads<Real>& threads);

}  // namespace clba
