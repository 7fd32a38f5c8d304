// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstddef>
#include <limits>
#include <string>

namespace clba {

enum class Precision : int { double_precision = 1, mixed = 2, single = 3 };  // clba.h

// REAL of the kernels: what the Jacobian is kept in and products are computed in.
inline const char* real_type(Precision precision) {
    return precision == Precision::double_precision ? "double" : "float";
}
inline size_t real_bytes(Precision precision) {
    return precision == Precision::double_precision ? sizeof(double) : sizeof(float);
}
inline double real_epsilon(Precision precision) {
    return precision == Precision::double_precision ? std::numeric_limits<double>::epsilon()
                                                    : std::numeric_limits<float>::epsilon();
}
// WIDE of the kernels: states, residuals, image vectors and long sums.
inline const char* wide_type(Precision precision) {
    return precision == Precision::single ? "float" : "double";
}
inline size_t wide_bytes(Precision precision) {
    return precision == Precision::single ? sizeof(float) : sizeof(double);
}
// How many numbers a coordinate of a position is kept in (kernels/positions.clh).
inline int position_parts(Precision precision) {
    return precision == Precision::single ? 2 : 1;
}
inline std::string precision_defines(Precision precision) {
    return std::string("-DREAL=") + real_type(precision) + " -DWIDE=" + wide_type(precision) +
           (precision == Precision::single ? " -DNO_DOUBLE -cl-single-precision-constant" : "");
}
// visit(WIDE()): for code that is a template of the type of WIDE.
template <class Visit>
decltype(auto) with_wide(Precision precision, Visit&& visit) {
    return precision == Precision::single ? visit(float()) : visit(double());
}

}  // namespace clba
