# SPDX-License-Identifier: Apache-2.0
# cmake -DKERNEL_DIR=... -DOUTPUT=... -P EmbedKernels.cmake: writes the kernel sources as byte arrays,
# so that the installed library needs no source files.
file(GLOB_RECURSE sources RELATIVE ${KERNEL_DIR} ${KERNEL_DIR}/*.cl ${KERNEL_DIR}/*.clh)
list(SORT sources)
set(arrays "")
set(rows "")
set(index 0)
foreach(source IN LISTS sources)
  file(READ ${KERNEL_DIR}/${source} bytes HEX)
  string(REGEX REPLACE "(..)" "0x\\1," bytes "${bytes}")
  string(APPEND arrays "const char source_${index}[] = {${bytes}0};\n")
  string(APPEND rows "    {\"${source}\", source_${index}},\n")
  math(EXPR index "${index} + 1")
endforeach()
file(WRITE ${OUTPUT}.tmp "// Generated from kernels/ by cmake/EmbedKernels.cmake.
#include \"device/kernel_source.hpp\"

namespace clba {
namespace {
${arrays}}  // namespace

const EmbeddedKernel embedded_kernels[] = {
${rows}};
const int num_embedded_kernels = ${index};

}  // namespace clba
")
file(COPY_FILE ${OUTPUT}.tmp ${OUTPUT} ONLY_IF_DIFFERENT)
file(REMOVE ${OUTPUT}.tmp)
