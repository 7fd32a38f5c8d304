// SPDX-License-Identifier: Apache-2.0
#include "linear/dense_kernels.hpp"

#include <cmath>
#include <limits>

#include "base/error.hpp"

#if defined(__x86_64__) && defined(__GNUC__)
#define CLBA_KERNELS_FOR_X86
#endif

namespace clba {
namespace {

#define CLBA_KERNEL_SET baseline
#define CLBA_KERNEL_TARGET
#define CLBA_KERNEL_VECTOR_BYTES 16
#define CLBA_KERNEL_COLUMNS 4
#include "linear/dense_kernels_body.inc"
#undef CLBA_KERNEL_SET
#undef CLBA_KERNEL_TARGET
#undef CLBA_KERNEL_VECTOR_BYTES
#undef CLBA_KERNEL_COLUMNS

#ifdef CLBA_KERNELS_FOR_X86
#define CLBA_KERNEL_SET avx2
#define CLBA_KERNEL_TARGET __attribute__((target("avx2,fma")))
#define CLBA_KERNEL_VECTOR_BYTES 32
#define CLBA_KERNEL_COLUMNS 4
#include "linear/dense_kernels_body.inc"
#undef CLBA_KERNEL_SET
#undef CLBA_KERNEL_TARGET
#undef CLBA_KERNEL_VECTOR_BYTES
#undef CLBA_KERNEL_COLUMNS

#define CLBA_KERNEL_SET avx512
#define CLBA_KERNEL_TARGET __attribute__((target("avx512f,avx512vl,avx512bw,avx512dq,avx2,fma")))
#define CLBA_KERNEL_VECTOR_BYTES 64
#define CLBA_KERNEL_COLUMNS 8
#include "linear/dense_kernels_body.inc"
#undef CLBA_KERNEL_SET
#undef CLBA_KERNEL_TARGET
#undef CLBA_KERNEL_VECTOR_BYTES
#undef CLBA_KERNEL_COLUMNS
#endif

}  // namespace

std::vector<InstructionSet> available_instruction_sets() {
    std::vector<InstructionSet> sets = {InstructionSet::baseline};
#ifdef CLBA_KERNELS_FOR_X86
    const bool has_avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    if (has_avx2) sets.push_back(InstructionSet::avx2);
    if (has_avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq"))
        sets.push_back(InstructionSet::avx512);
#endif
    return sets;
}

template <class Real>
const DenseKernels<Real>& dense_kernels(InstructionSet set) {
    switch (set) {
        case InstructionSet::baseline:
            return baseline::kernels<Real>;
#ifdef CLBA_KERNELS_FOR_X86
        case InstructionSet::avx2:
            return avx2::kernels<Real>;
        case InstructionSet::avx512:
            return avx512::kernels<Real>;
#else
        default:
            break;
#endif
    }
    fail(Status::internal, "dense kernels: this build lacks the instruction set");
}

template const DenseKernels<float>& dense_kernels(InstructionSet set);
template const DenseKernels<double>& dense_kernels(InstructionSet set);

}  // namespace clba
