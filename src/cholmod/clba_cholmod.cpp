// SPDX-License-Identifier: Apache-2.0
#include "cholmod/clba_cholmod.h"

#include <cholmod.h>

#include <cstdio>
#include <cstring>
#include <new>

struct clba_cholmod {
    cholmod_common common{};
    cholmod_sparse matrix{};
    cholmod_factor* factor = nullptr;
    // Workspaces that cholmod_l_solve2 keeps between calls.
    cholmod_dense* x = nullptr;
    cholmod_dense* y = nullptr;
    cholmod_dense* e = nullptr;
    char message[256] = "";
};

namespace {

// CHOLMOD's error handler has no user data: the handle that this thread works on.
thread_local clba_cholmod* active = nullptr;

void keep_message(int status, const char* /*file*/, int /*line*/, const char* message) {
    const bool is_warning = status > 0;
    if (active && !is_warning)
        std::snprintf(active->message, sizeof(active->message), "CHOLMOD error %d: %s", status,
                      message);
}

class Work {
public:
    explicit Work(clba_cholmod* handle) {
        handle->message[0] = '\0';
        active = handle;
    }
    ~Work() { active = nullptr; }
    Work(const Work&) = delete;
    Work& operator=(const Work&) = delete;
};

int32_t failure(clba_cholmod* handle) {
    if (!handle->message[0])
        std::snprintf(handle->message, sizeof(handle->message), "CHOLMOD failed with status %d",
                      handle->common.status);
    return handle->common.status == CHOLMOD_OUT_OF_MEMORY ? CLBA_CHOLMOD_OUT_OF_MEMORY
                                                          : CLBA_CHOLMOD_ERROR;
}

}  // namespace

int32_t clba_cholmod_version(void) {
    return CLBA_CHOLMOD_VERSION;
}

clba_cholmod* clba_cholmod_create(int64_t n, const int64_t* column_starts, const int64_t* rows) {
    auto* handle = new (std::nothrow) clba_cholmod;
    if (!handle) return nullptr;
    cholmod_common& common = handle->common;
    cholmod_l_start(&common);
    common.print = 0;
    common.error_handler = keep_message;
    common.supernodal = CHOLMOD_SUPERNODAL;
    common.quick_return_if_not_posdef = 1;

    // CHOLMOD only reads the matrix it is given.
    cholmod_sparse& matrix = handle->matrix;
    matrix.nrow = matrix.ncol = static_cast<size_t>(n);
    matrix.nzmax = static_cast<size_t>(column_starts[n]);
    matrix.p = const_cast<int64_t*>(column_starts);
    matrix.i = const_cast<int64_t*>(rows);
    matrix.stype = -1;
    matrix.itype = CHOLMOD_LONG;
    matrix.xtype = CHOLMOD_PATTERN;
    matrix.dtype = CHOLMOD_DOUBLE;
    matrix.sorted = 1;
    matrix.packed = 1;
    return handle;
}

void clba_cholmod_destroy(clba_cholmod* handle) {
    if (!handle) return;
    cholmod_common* common = &handle->common;
    cholmod_l_free_dense(&handle->x, common);
    cholmod_l_free_dense(&handle->y, common);
    cholmod_l_free_dense(&handle->e, common);
    cholmod_l_free_factor(&handle->factor, common);
    cholmod_l_finish(common);
    delete handle;
}

int32_t clba_cholmod_analyze(clba_cholmod* handle) {
    const Work work(handle);
    cholmod_l_free_factor(&handle->factor, &handle->common);
    handle->factor = cholmod_l_analyze(&handle->matrix, &handle->common);
    return handle->factor ? CLBA_CHOLMOD_OK : failure(handle);
}

int32_t clba_cholmod_factorize(clba_cholmod* handle, const double* values) {
    const Work work(handle);
    cholmod_sparse matrix = handle->matrix;
    matrix.x = const_cast<double*>(values);
    matrix.xtype = CHOLMOD_REAL;
    const int done = cholmod_l_factorize(&matrix, handle->factor, &handle->common);
    if (handle->common.status == CHOLMOD_NOT_POSDEF) return CLBA_CHOLMOD_NOT_POSITIVE_DEFINITE;
    return done ? CLBA_CHOLMOD_OK : failure(handle);
}

int32_t clba_cholmod_solve(clba_cholmod* handle, const double* b, double* x) {
    const Work work(handle);
    cholmod_dense right{};
    right.nrow = right.d = right.nzmax = handle->matrix.nrow;
    right.ncol = 1;
    right.x = const_cast<double*>(b);
    right.xtype = CHOLMOD_REAL;
    right.dtype = CHOLMOD_DOUBLE;
    if (!cholmod_l_solve2(CHOLMOD_A, handle->factor, &right, nullptr, &handle->x, nullptr,
                          &handle->y, &handle->e, &handle->common))
        return failure(handle);
    std::memcpy(x, handle->x->x, sizeof(double) * handle->matrix.nrow);
    return CLBA_CHOLMOD_OK;
}

int64_t clba_cholmod_factor_nonzeros(const clba_cholmod* handle) {
    return static_cast<int64_t>(handle->common.lnz);
}

const char* clba_cholmod_message(const clba_cholmod* handle) {
    return handle->message;
}
