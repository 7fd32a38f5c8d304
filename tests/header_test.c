/* SPDX-License-Identifier: Apache-2.0 */
/* clba.h compiles as C99 without warnings or padding; the C++ half compares the sizes. */
#include "header_test.h"

#define SIZE(name) sizeof(name),
const size_t sizes_in_c[] = {CLBA_PUBLIC_STRUCTS(SIZE) 0};
