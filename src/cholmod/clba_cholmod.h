/* SPDX-License-Identifier: Apache-2.0
 *
 * clba_cholmod.h -- sparse Cholesky factorisation by CHOLMOD's supernodal module. That module is
 * GPL, so it is linked to this small library alone, which clba opens at run time and does without
 * when it is absent. A handle is used by one thread at a time. Nothing is printed. */
#ifndef CLBA_CHOLMOD_H
#define CLBA_CHOLMOD_H
#include <stdint.h>

#if defined(__GNUC__)
#define CLBA_CHOLMOD_API __attribute__((visibility("default")))
#else
#define CLBA_CHOLMOD_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define CLBA_CHOLMOD_VERSION 1 /* of this interface; raised whenever it changes */

enum {
    CLBA_CHOLMOD_OK = 0,
    CLBA_CHOLMOD_NOT_POSITIVE_DEFINITE = 1, /* clba_cholmod_factorize only */
    CLBA_CHOLMOD_ERROR = -1,                /* clba_cholmod_message() says what */
    CLBA_CHOLMOD_OUT_OF_MEMORY = -2
};

typedef struct clba_cholmod clba_cholmod;

/* CLBA_CHOLMOD_VERSION of the library loaded. Every version has this function. */
CLBA_CHOLMOD_API int32_t clba_cholmod_version(void);

/* The lower triangle of a symmetric n x n matrix by compressed columns, rows ascending: column j
 * has the entries [column_starts[j], column_starts[j + 1]). Both arrays are the caller's, and must
 * live as long as the handle. NULL: out of memory. */
CLBA_CHOLMOD_API clba_cholmod* clba_cholmod_create(int64_t n, const int64_t* column_starts,
                                                   const int64_t* rows);
CLBA_CHOLMOD_API void clba_cholmod_destroy(clba_cholmod* handle); /* NULL is allowed */

/* Fill-reducing ordering (AMD, or METIS where AMD fills much) and symbolic factorisation. Once,
 * before the functions below. */
CLBA_CHOLMOD_API int32_t clba_cholmod_analyze(clba_cholmod* handle);
/* values[k] belongs to rows[k]. May be called any number of times. */
CLBA_CHOLMOD_API int32_t clba_cholmod_factorize(clba_cholmod* handle, const double* values);
/* Solves A x = b with the last factor, which must have been CLBA_CHOLMOD_OK. x may be b. */
CLBA_CHOLMOD_API int32_t clba_cholmod_solve(clba_cholmod* handle, const double* b, double* x);

/* Entries of the factor, from the analysis. */
CLBA_CHOLMOD_API int64_t clba_cholmod_factor_nonzeros(const clba_cholmod* handle);
/* Why the last call on this handle failed. */
CLBA_CHOLMOD_API const char* clba_cholmod_message(const clba_cholmod* handle);

#ifdef __cplusplus
}
#endif
#endif /* CLBA_CHOLMOD_H */
