// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <limits>
#include <memory>
#include <ostream>
#include <string>
#include <vector>

#include "device/context.hpp"
#include "linear/device_problem.hpp"
#include "linear/normal_equations.hpp"
#include "optimizer/evaluator.hpp"
#include "reference/bundle.hpp"

// What the tests of kernels share: the device, the shapes that kernels are launched in, and a
// problem on the device whose results are read back in the caller's order.
namespace clba::test {

bool is_small();  // CLBA_TEST_SIZE=small: for devices that are simulated

// One context of the device that CLBA_DEVICE names, for all tests of a program. A limit on buffers
// makes a context of its own.
std::shared_ptr<Context> test_context(uint64_t max_allocation_bytes = 0);

// How kernels are launched; work_group_size 0 stands for the device's own tuning.
struct Shape {
    std::string name;
    int work_group_size = 0;  // 1 with lane_loop
    bool lane_loop = false;
    bool vectorize = false;  // where the device can
    int vector_groups = 8;
    int lanes = 16;
    int32_t points_per_tile = 4096;
};
inline std::ostream& operator<<(std::ostream& stream, const Shape& shape) {
    return stream << shape.name;
}
inline Shape device_shape() {
    Shape shape;
    shape.name = "device";
    return shape;
}
Shape loop_shape(const std::string& name, bool vectorize, int vector_groups, int lanes,
                 int32_t points_per_tile);
Shape group_shape(int work_group_size, int vector_groups, int lanes, int32_t points_per_tile);

// For the queues made from now on.
void set_shape(Context& context, const Shape& shape);

inline double epsilon(Precision precision) {
    return precision == Precision::double_precision
               ? std::numeric_limits<double>::epsilon()
               : static_cast<double>(std::numeric_limits<float>::epsilon());
}

// A problem on the device, linearised at its state. Results are in the caller's order.
class Rig {
public:
    Rig(const std::shared_ptr<Context>& context, const Problem& problem, Precision precision,
        JacobianForm form, const DampingOptions& damping = {});

    CostEvaluation cost();  // fills residuals
    reference::Jacobian jacobian();
    bool padding_is_zero();  // of what is kept of the Jacobian, and of its blocks
    std::vector<double> product();
    void set_product(const std::vector<double>& y);
    std::vector<double> gradient();
    std::vector<double> damping();

    Vector upload(const std::vector<double>& values);          // F and E
    Vector upload_reduced(const std::vector<double>& values);  // F alone
    std::vector<double> download(const Vector& vector);
    std::vector<double> download_reduced(const Vector& vector);

    // Row-major lower triangles, the rest 0: a block each, and 9 numbers a point.
    std::vector<std::vector<double>> image_matrices(const Buffer& packed);
    std::vector<double> point_matrices(const std::vector<Buffer>& rows);
    std::vector<double> point_blocks();  // V = L L^T of the roots: 9 numbers a point
    // Rows of REAL a chunk: num_rows numbers a point.
    std::vector<double> point_values(const std::vector<Buffer>& rows, size_t num_rows);
    std::vector<double> scales();  // of all parameters

    Precision precision;
    DeviceProblem device;
    Evaluator evaluator;
    NormalEquations equations;
    std::vector<double> residuals;

private:
    template <class RowsOf, class Visit>
    void visit_reals(const std::vector<Buffer>& slots, RowsOf&& rows_of, Visit&& visit);
    template <class RowsOf>
    bool padding_is_zero(const std::vector<Buffer>& slots, RowsOf&& rows_of);

    Problem problem_;
    JacobianForm form_;
};

}  // namespace clba::test
