/* SPDX-License-Identifier: Apache-2.0 */
/* Sizes of the public structs in header order, as C sees them. */
#ifndef CLBA_HEADER_TEST_H
#define CLBA_HEADER_TEST_H
#include <stddef.h>

#include "clba/clba.h"

#define CLBA_PUBLIC_STRUCTS(apply)                                                 \
    apply(clba_device_info) apply(clba_context_options) apply(clba_problem_info)   \
        apply(clba_iteration) apply(clba_solver_options) apply(clba_summary)       \
            apply(clba_evaluation) apply(clba_comparison) apply(clba_read_options) \
                apply(clba_write_options) apply(clba_scene_options)

#ifdef __cplusplus
extern "C"
#else
extern
#endif
    const size_t sizes_in_c[];

#endif
