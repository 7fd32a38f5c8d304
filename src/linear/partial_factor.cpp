// SPDX-License-Identifier: Apache-2.0
#include "linear/partial_factor.hpp"

#include <algorithm>

namespace clba {
namespace {

// Columns that are factored at once, and rows and columns of the tasks that threads share. The cuts
// do not depend on the number of threads.
constexpr int64_t panel_columns = 64, panel_rows = kernel_rows, task_size = kernel_columns;
constexpr int64_t solve_columns = 256, solve_rows = 1024, solve_task_columns = 32;
// Multiplications from which sharing a loop pays.
constexpr int64_t min_shared_products = 500000;
constexpr int64_t min_shared_entries = 100000;

template <class Real>
struct Factorization {
    const FrontTarget<Real>& front;
    int64_t m;
    const DenseThreads<Real>& threads;

    Real* at(int64_t row, int64_t column) const {
        return front.panel + row + column * front.panel_stride;
    }

    // C -= L(row.., depth_begin..depth_end) L(row..row + columns, the same)^T below the diagonal,
    // C being of the rows from row.
    void update(Real* c, int64_t c_stride, int64_t row, int64_t columns, int64_t depth_begin,
                int64_t depth_end) const {
        struct Tile {
            int64_t i, j;
        };
        const int64_t rows = m - row, depth = depth_end - depth_begin;
        const auto subtract = [&](int64_t i, int64_t num_i, int64_t j, int64_t num_j, int worker) {
            threads.kernels->subtract_product(c + i + j * c_stride, c_stride,
                                              at(row + i, depth_begin), front.panel_stride, num_i,
                                              at(row + j, depth_begin), front.panel_stride, num_j,
                                              depth, i - j, threads.workspace(worker));
        };
        const bool large = columns * (rows - columns / 2) * depth >= min_shared_products;
        if (!threads.pool || !large) return subtract(0, rows, 0, columns, threads.worker);
        // Tiles by rows of tiles from the bottom: the halves on the diagonal come last.
        const int64_t size = rows >= 4 * task_size ? task_size : task_size / 4;
        const int64_t across = (columns + size - 1) / size, down = (rows + size - 1) / size;
        const int64_t square = across * (across + 1) / 2;
        const auto tile = [&](int64_t index) {
            const int64_t rectangle = (down - across) * across;
            if (index < rectangle) return Tile{down - 1 - index / across, index % across};
            index -= rectangle;
            int64_t i = across - 1;
            for (; index > i; --i) index -= i + 1;
            return Tile{i, index};
        };
        threads.run((down - across) * across + square, true, [&](int64_t index, int worker) {
            const Tile at_tile = tile(index);
            const int64_t i = at_tile.i * size, j = at_tile.j * size;
            subtract(i, std::min(size, rows - i), j, std::min(size, columns - j), worker);
        });
    }

    bool factor_panel(int64_t begin, int64_t end) const {
        const int64_t n = end - begin, rows = m - end;
        if (!threads.kernels->factor(at(begin, begin), front.panel_stride, n,
                                     threads.workspace(threads.worker)))
            return false;
        threads.run((rows + panel_rows - 1) / panel_rows, rows * n * n / 2 >= min_shared_products,
                    [&](int64_t index, int worker) {
                        const int64_t row = end + index * panel_rows;
                        threads.kernels->solve_rows(at(begin, begin), front.panel_stride, n,
                                                    at(row, begin), front.panel_stride,
                                                    std::min(panel_rows, m - row),
                                                    threads.workspace(worker));
                    });
        return true;
    }

    bool factor_columns(int64_t begin, int64_t end) const {
        if (end - begin <= panel_columns) return factor_panel(begin, end);
        const int64_t panels = (end - begin + panel_columns - 1) / panel_columns;
        const int64_t middle = begin + panels / 2 * panel_columns;
        if (!factor_columns(begin, middle)) return false;
        update(at(middle, middle), front.panel_stride, middle, end - middle, begin, middle);
        return factor_columns(middle, end);
    }
};

}  // namespace

template <class Real>
bool partial_factor(const FrontTarget<Real>& front, int64_t m, const DenseThreads<Real>& threads) {
    const Factorization<Real> factorization{front, m, threads};
    if (!factorization.factor_columns(0, front.num_pivots)) return false;
    if (m > front.num_pivots)
        factorization.update(front.update, front.update_stride, front.num_pivots,
                             m - front.num_pivots, 0, front.num_pivots);
    return true;
}

template <class Real>
void solve_forward(const Real* l, int64_t stride, int64_t m, int64_t n, Real* y,
                   const DenseThreads<Real>& threads) {
    for (int64_t j = 0; j < n; j += solve_columns) {
        const int64_t columns = std::min(solve_columns, n - j), end = j + columns;
        threads.kernels->solve_forward(l + j + j * stride, stride, columns, columns, y + j);
        threads.run((m - end + solve_rows - 1) / solve_rows,
                    (m - end) * columns >= min_shared_entries, [&](int64_t index, int) {
                        const int64_t row = end + index * solve_rows;
                        threads.kernels->subtract_times(l + row + j * stride, stride,
                                                        std::min(solve_rows, m - row), columns,
                                                        y + j, y + row);
                    });
    }
}

template <class Real>
void solve_backward(const Real* l, int64_t stride, int64_t m, int64_t n, Real* y,
                    const DenseThreads<Real>& threads) {
    for (int64_t end = n; end > 0;) {
        const int64_t j = (end - 1) / solve_columns * solve_columns, columns = end - j;
        threads.run((columns + solve_task_columns - 1) / solve_task_columns,
                    (m - end) * columns >= min_shared_entries, [&](int64_t index, int) {
                        const int64_t column = j + index * solve_task_columns;
                        threads.kernels->subtract_transposed_times(
                            l + end + column * stride, stride, m - end,
                            std::min(solve_task_columns, end - column), y + end, y + column);
                    });
        threads.kernels->solve_backward(l + j + j * stride, stride, columns, columns, y + j);
        end = j;
    }
}

template bool partial_factor(const FrontTarget<float>&, int64_t, const DenseThreads<float>&);
template bool partial_factor(const FrontTarget<double>&, int64_t, const DenseThreads<double>&);
template void solve_forward(const float*, int64_t, int64_t, int64_t, float*,
                            const DenseThreads<float>&);
template void solve_forward(const double*, int64_t, int64_t, int64_t, double*,
                            const DenseThreads<double>&);
template void solve_backward(const float*, int64_t, int64_t, int64_t, float*,
                             const DenseThreads<float>&);
template void solve_backward(const double*, int64_t, int64_t, int64_t, double*,
                             const DenseThreads<double>&);

}  // namespace clba
