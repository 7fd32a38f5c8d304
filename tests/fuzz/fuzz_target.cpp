// SPDX-License-Identifier: Apache-2.0
// A libFuzzer target for the parser CLBA_FUZZ_PARSER.
#include <cstddef>
#include <cstdint>

#include "fuzz/parsers.hpp"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* bytes, size_t size) {
    using namespace clba::test;
    static const Parser& parser = parser_named(CLBA_FUZZ_PARSER);
    accepts(parser, {reinterpret_cast<const char*>(bytes), size});
    return 0;
}
