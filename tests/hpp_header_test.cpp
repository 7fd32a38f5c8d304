// SPDX-License-Identifier: Apache-2.0
// clba.hpp compiles alone, twice, and in a second file of one program.
#include <clba/clba.hpp>
// Guarded.
#include <clba/clba.hpp>

namespace clba_test {

int32_t num_models_elsewhere() {
    return clba::num_camera_models();
}

}  // namespace clba_test
