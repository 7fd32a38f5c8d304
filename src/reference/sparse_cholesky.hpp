// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "cholmod/clba_cholmod.h"

namespace clba::reference {

// The functions of the plug-in library clba_cholmod (see clba_cholmod.h).
struct CholmodPlugin {
    decltype(clba_cholmod_create)* create = nullptr;
    decltype(clba_cholmod_destroy)* destroy = nullptr;
    decltype(clba_cholmod_analyze)* analyze = nullptr;
    decltype(clba_cholmod_factorize)* factorize = nullptr;
    decltype(clba_cholmod_solve)* solve = nullptr;
    decltype(clba_cholmod_factor_nonzeros)* factor_nonzeros = nullptr;
    decltype(clba_cholmod_message)* message = nullptr;
};

// Opens the library that environment CLBA_CHOLMOD names, or, where that is unset or empty, the one
// beside clba or else the one that the system's loader finds. Throws a no_plugin error when there
// is none or its interface has another version.
CholmodPlugin open_cholmod_plugin(int32_t version = CLBA_CHOLMOD_VERSION);

// A = L L^T of a sparse symmetric positive definite matrix of fixed pattern, on the host. The
// plug-in is opened when the process makes its first one.
class SparseCholesky {
public:
    // Lower triangle of an n x n matrix by compressed columns, rows ascending; n + 1 column starts.
    SparseCholesky(std::vector<int64_t> column_starts, std::vector<int64_t> rows);

    // values[k] belongs to rows[k]. False: not positive definite.
    bool factorize(const double* values);
    // A x = b with the last factor, which must have been positive definite. x may be b.
    void solve(const double* b, double* x);
    int64_t num_factor_nonzeros() const;
    const std::vector<int64_t>& column_starts() const { return column_starts_; }
    const std::vector<int64_t>& rows() const { return rows_; }

private:
    void check(int32_t status) const;

    std::vector<int64_t> column_starts_;
    std::vector<int64_t> rows_;
    std::unique_ptr<clba_cholmod, decltype(clba_cholmod_destroy)*> handle_;
};

}  // namespace clba::reference
