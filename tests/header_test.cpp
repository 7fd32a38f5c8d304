// SPDX-License-Identifier: Apache-2.0
// clba.h compiles as C++ without warnings or padding, its structs are as long as in C, and the
// library that is linked has the header's version.
#include "header_test.h"

#include <cstdio>
#include <type_traits>

#define LAYOUT(name)                                                                     \
    static_assert(std::is_standard_layout_v<name> && std::is_trivially_copyable_v<name>, \
                  #name " must be a plain C struct");                                    \
    static_assert(offsetof(name, struct_size) == 0, #name " must begin with struct_size");
CLBA_PUBLIC_STRUCTS(LAYOUT)

#define SIZE(name) sizeof(name),
#define NAME(name) #name,

int main() {
    const size_t sizes[] = {CLBA_PUBLIC_STRUCTS(SIZE) 0};
    const char* const names[] = {CLBA_PUBLIC_STRUCTS(NAME) nullptr};
    int failures = 0;
    for (int i = 0; names[i]; ++i) {
        if (sizes[i] == sizes_in_c[i]) continue;
        std::fprintf(stderr, "%s: %zu bytes in C++, %zu in C\n", names[i], sizes[i], sizes_in_c[i]);
        ++failures;
    }
    if (clba_version() != CLBA_VERSION) {
        std::fprintf(stderr, "header version %d, library %u\n", CLBA_VERSION, clba_version());
        ++failures;
    }
    return failures;
}
