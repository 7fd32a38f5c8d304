/* SPDX-License-Identifier: Apache-2.0
 * Peak resident memory of this process since the last reset: for bench/peers. */
#ifndef CLBA_BENCH_PEERS_MEMORY_H
#define CLBA_BENCH_PEERS_MEMORY_H
#include <stdio.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

/* Linux: "5" sets VmHWM back to what is resident now. Elsewhere nothing happens. */
static inline void peers_reset_peak_memory(void) {
#ifdef __GLIBC__
    malloc_trim(0);
#endif
    FILE* file = fopen("/proc/self/clear_refs", "w");
    if (!file) return;
    fputs("5", file);
    fclose(file);
}

/* Bytes; 0 where there is no /proc. */
static inline unsigned long long peers_peak_memory(void) {
    FILE* file = fopen("/proc/self/status", "r");
    if (!file) return 0;
    char line[256];
    unsigned long long kib = 0;
    while (fgets(line, sizeof line, file))
        if (sscanf(line, "VmHWM: %llu kB", &kib) == 1) break;
    fclose(file);
    return 1024 * kib;
}
#endif
