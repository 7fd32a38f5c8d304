// SPDX-License-Identifier: Apache-2.0
#include "linear/partial_inverse.hpp"

#include <algorithm>

#include "linear/arena.hpp"

namespace clba {
namespace {

constexpr int64_t tile_size = kernel_rows;
// Multiplications, and entries, from which sharing a loop pays.
constexpr int64_t min_shared_products = 500000, min_shared_entries = 100000;

int64_t num_tiles(int64_t n) {
    return (n + tile_size - 1) / tile_size;
}

template <class Real>
struct Inversion {
    const Real* l;
    int64_t l_stride, m, p;
    Real* z;
    int64_t z_stride;
    Real* scratch;  // p x p for L1^-T, then p x (m - p) for -W
    const DenseThreads<Real>& threads;

    int64_t stride() const { return padded<Real>(p); }
    Real* root_inverse(int64_t row, int64_t column) const {
        return scratch + row + column * stride();
    }
    Real* minus_w(int64_t row, int64_t column) const { return root_inverse(row, p + column); }
    Real* at(int64_t row, int64_t column) const { return z + row + column * z_stride; }

    // task(first row, rows, first column, columns, worker) for the tiles of a matrix.
    template <class Task>
    void for_tiles(int64_t rows, int64_t columns, int64_t products, const Task& task) const {
        const int64_t down = num_tiles(rows);
        threads.run(down * num_tiles(columns), products >= min_shared_products,
                    [&](int64_t index, int worker) {
                        const int64_t i = index % down * tile_size, j = index / down * tile_size;
                        task(i, std::min(tile_size, rows - i), j, std::min(tile_size, columns - j),
                             worker);
                    });
    }

    void subtract(Real* c, int64_t c_stride, const Real* a, int64_t a_stride, int64_t rows,
                  const Real* b, int64_t b_stride, int64_t columns, int64_t depth,
                  int worker) const {
        threads.kernels->subtract_product(c, c_stride, a, a_stride, rows, b, b_stride, columns,
                                          depth, columns, threads.workspace(worker));
    }

    // L1^-T is upper triangular: rows from i have nothing left of column i.
    void invert_root() const {
        threads.run(num_tiles(p), p * p * p / 6 >= min_shared_products,
                    [&](int64_t index, int worker) {
                        const int64_t i = index * tile_size, rows = std::min(tile_size, p - i);
                        for (int64_t j = 0; j < p; ++j)
                            std::fill_n(root_inverse(i, j), rows, Real(0));
                        for (int64_t k = 0; k < rows; ++k) *root_inverse(i + k, i + k) = 1;
                        threads.kernels->solve_rows(l + i + i * l_stride, l_stride, p - i,
                                                    root_inverse(i, i), stride(), rows,
                                                    threads.workspace(worker));
                    });
    }

    void find_minus_w() const {
        const int64_t r = m - p;
        for_tiles(p, r, p * p * r / 2,
                  [&](int64_t i, int64_t rows, int64_t j, int64_t columns, int worker) {
                      for (int64_t k = j; k < j + columns; ++k)
                          std::fill_n(minus_w(i, k), rows, Real(0));
                      subtract(minus_w(i, j), stride(), root_inverse(i, i), stride(), rows,
                               l + p + j + i * l_stride, l_stride, columns, p - i, worker);
                  });
    }

    void find_upper_right() const {
        const int64_t r = m - p;
        for_tiles(
            p, r, p * r * r, [&](int64_t i, int64_t rows, int64_t j, int64_t columns, int worker) {
                for (int64_t k = j; k < j + columns; ++k) std::fill_n(at(i, p + k), rows, Real(0));
                subtract(at(i, p + j), z_stride, minus_w(i, 0), stride(), rows, at(p + j, p),
                         z_stride, columns, r, worker);
                for (int64_t k = j; k < j + columns; ++k)
                    for (Real *entry = at(i, p + k), *end = entry + rows; entry < end; ++entry)
                        *entry = -*entry;
            });
    }

    // -Z_11, in tiles on and below the diagonal.
    void find_minus_upper_left() const {
        const int64_t r = m - p;
        for_tiles(p, p, p * p * (p / 3 + r) / 2,
                  [&](int64_t i, int64_t rows, int64_t j, int64_t columns, int worker) {
                      if (i < j) return;
                      for (int64_t k = j; k < j + columns; ++k)
                          std::fill_n(at(i, k), rows, Real(0));
                      subtract(at(i, j), z_stride, root_inverse(i, i), stride(), rows,
                               root_inverse(j, i), stride(), columns, p - i, worker);
                      subtract(at(i, j), z_stride, at(i, p), z_stride, rows, minus_w(j, 0),
                               stride(), columns, r, worker);
                  });
    }

    // Turns the sign of Z_11 and fills the other triangle. Both entries of a pair are written by
    // the task of the lower one's column.
    void mirror() const {
        threads.run(num_tiles(p), p * m >= min_shared_entries, [&](int64_t index, int) {
            for (int64_t j = index * tile_size; j < std::min(p, (index + 1) * tile_size); ++j) {
                for (int64_t i = j; i < p; ++i) *at(j, i) = *at(i, j) = -*at(i, j);
                for (int64_t i = p; i < m; ++i) *at(i, j) = *at(j, i);
            }
        });
    }
};

}  // namespace

template <class Real>
int64_t partial_inverse_scratch(int64_t m, int64_t p) {
    return padded<Real>(p) * m;
}

template <class Real>
void partial_inverse(const Real* l, int64_t l_stride, int64_t m, int64_t p, Real* z,
                     int64_t z_stride, Real* scratch, const DenseThreads<Real>& threads) {
    const Inversion<Real> inversion{l, l_stride, m, p, z, z_stride, scratch, threads};
    inversion.invert_root();
    inversion.find_minus_w();
    inversion.find_upper_right();
    inversion.find_minus_upper_left();
    inversion.mirror();
}

template int64_t partial_inverse_scratch<float>(int64_t, int64_t);
template int64_t partial_inverse_scratch<double>(int64_t, int64_t);
template void partial_inverse(const float*, int64_t, int64_t, int64_t, float*, int64_t, float*,
                              const DenseThreads<float>&);
template void partial_inverse(const double*, int64_t, int64_t, int64_t, double*, int64_t, double*,
                              const DenseThreads<double>&);

}  // namespace clba
