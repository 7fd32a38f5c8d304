// SPDX-License-Identifier: Apache-2.0
#include "device_rig.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <cstring>
#include <map>

namespace clba::test {
namespace {

struct TestContext {
    std::shared_ptr<Context> context;
    Tuning tuning;  // the device's own
};

TestContext make_context(uint64_t max_allocation_bytes) {
    ContextOptions options;
    const char* device = std::getenv("CLBA_DEVICE");
    options.device = device ? device : "";
    options.max_allocation_bytes = max_allocation_bytes;
    const auto context = std::make_shared<Context>(options);
    return {context, context->tuning};
}

std::map<uint64_t, TestContext>& contexts() {
    static std::map<uint64_t, TestContext> made;
    return made;
}

// A driver may be gone before the objects of static lifetime are.
class ContextRelease : public testing::Environment {
    void TearDown() override { contexts().clear(); }
};
const auto* const context_release = testing::AddGlobalTestEnvironment(new ContextRelease);

int two_rows(const CameraModel&) {
    return 2;
}

}  // namespace

bool is_small() {
    const char* size = std::getenv("CLBA_TEST_SIZE");
    return size && std::strcmp(size, "small") == 0;
}

std::shared_ptr<Context> test_context(uint64_t max_allocation_bytes) {
    const auto found = contexts().find(max_allocation_bytes);
    if (found != contexts().end()) return found->second.context;
    return contexts()
        .emplace(max_allocation_bytes, make_context(max_allocation_bytes))
        .first->second.context;
}

Shape loop_shape(const std::string& name, bool vectorize, int vector_groups, int lanes,
                 int32_t points_per_tile) {
    return {name, 1, true, vectorize, vector_groups, lanes, points_per_tile};
}

Shape group_shape(int work_group_size, int vector_groups, int lanes, int32_t points_per_tile) {
    return {"groups_of_" + std::to_string(work_group_size),
            work_group_size,
            false,
            false,
            vector_groups,
            lanes,
            points_per_tile};
}

void set_shape(Context& context, const Shape& shape) {
    for (const auto& [limit, made] : contexts()) {
        if (made.context.get() != &context) continue;
        context.tuning = made.tuning;
        if (shape.work_group_size == 0) return;
        context.tuning.lane_loop = shape.lane_loop;
        context.tuning.vectorize = shape.vectorize && made.tuning.vectorize;
        context.tuning.work_group_size = shape.work_group_size;
        context.tuning.vector_groups = shape.vector_groups;
        context.tuning.pcg_interval = shape.lane_loop ? 1 : 3;
        context.tuning.lanes = shape.lanes;
        context.tuning.points_per_tile = shape.points_per_tile;
    }
}

Rig::Rig(const std::shared_ptr<Context>& context, const Problem& problem, Precision in_precision,
         JacobianForm form, const DampingOptions& damping)
    : precision(in_precision),
      device(context, problem, precision),
      evaluator(device, problem),
      equations(device, damping, form, problem.loss),
      problem_(problem),
      form_(form) {
    device.upload_state(problem);
    evaluator.linearize(equations);
}

CostEvaluation Rig::cost() {
    std::vector<Buffer> slots = device.make_slot_rows(two_rows, sizeof(double), "residuals");
    const CostEvaluation evaluation = evaluator.cost(device.state, &slots);
    residuals.resize(2 * problem_.observations.size());
    device.visit_slots<double>(slots, two_rows, [&](int64_t i, int, auto&& value) {
        residuals[2 * i] = value(0);
        residuals[2 * i + 1] = value(1);
    });
    return evaluation;
}

template <class RowsOf, class Visit>
void Rig::visit_reals(const std::vector<Buffer>& slots, RowsOf&& rows_of, Visit&& visit) {
    if (precision == Precision::double_precision)
        device.visit_slots<double>(slots, rows_of, visit);
    else
        device.visit_slots<float>(slots, rows_of, visit);
}

reference::Jacobian Rig::jacobian() {
    reference::Jacobian jacobian;
    jacobian.columns = device.layout().max_image_columns;
    const size_t num_observations = problem_.observations.size();
    for (const Observation& observation : problem_.observations) {
        jacobian.image.push_back(observation.image);
        jacobian.point.push_back(observation.point);
    }
    jacobian.image_blocks.assign(num_observations * 2 * jacobian.columns, 0.0);
    jacobian.point_blocks.assign(num_observations * 6, 0.0);
    visit_reals(equations.jacobian.blocks(), Jacobian::num_block_rows,
                [&](int64_t i, int columns, auto&& value) {
                    for (int row = 0; row < 2; ++row)
                        for (int k = 0; k < columns; ++k)
                            jacobian.image_blocks[(2 * i + row) * jacobian.columns + k] =
                                static_cast<double>(value(row * columns + k));
                    for (int k = 0; k < 6; ++k)
                        jacobian.point_blocks[6 * i + k] =
                            static_cast<double>(value(2 * columns + k));
                });
    return jacobian;
}

template <class RowsOf>
bool Rig::padding_is_zero(const std::vector<Buffer>& slots, RowsOf&& rows_of) {
    int64_t num_nonzero = 0, num_of_observations = 0;
    const auto count = [](auto value, int64_t& total) { total += value == 0 ? 0 : 1; };
    visit_reals(slots, rows_of, [&](int64_t i, int, auto&& value) {
        const Image& image = problem_.images[problem_.observations[i].image];
        const int rows = rows_of(camera_models[problem_.cameras[image.camera].model]);
        for (int k = 0; k < rows; ++k) count(value(k), num_of_observations);
    });
    for (const Buffer& buffer : slots) {
        const auto n = static_cast<int64_t>(buffer.bytes() / real_bytes(precision));
        if (precision == Precision::double_precision) {
            const auto values = buffer.map_read<double>();
            for (int64_t k = 0; k < n; ++k) count(values[k], num_nonzero);
        } else {
            const auto values = buffer.map_read<float>();
            for (int64_t k = 0; k < n; ++k) count(values[k], num_nonzero);
        }
    }
    return num_nonzero == num_of_observations;
}

bool Rig::padding_is_zero() {
    const auto num_rows = [&](const CameraModel& model) {
        return form_ == JacobianForm::stored
                   ? Jacobian::num_block_rows(model)
                   : equations.jacobian.num_view_rows(model, !problem_.whitening.empty());
    };
    return padding_is_zero(equations.jacobian.rows(), num_rows) &&
           padding_is_zero(equations.jacobian.blocks(), Jacobian::num_block_rows);
}

std::vector<double> Rig::product() {
    std::vector<double> y(2 * problem_.observations.size());
    visit_reals(equations.jacobian.product(), Jacobian::num_product_rows,
                [&](int64_t i, int, auto&& value) {
                    y[2 * i] = static_cast<double>(value(0));
                    y[2 * i + 1] = static_cast<double>(value(1));
                });
    return y;
}

void Rig::set_product(const std::vector<double>& y) {
    const auto fill = [&](auto zero) {
        using Real = decltype(zero);
        device.fill_slots<Real>(equations.jacobian.product(), Jacobian::num_product_rows,
                                [&](int64_t i, int, auto&& value) {
                                    value(0) = static_cast<Real>(y[2 * i]);
                                    value(1) = static_cast<Real>(y[2 * i + 1]);
                                });
    };
    if (precision == Precision::double_precision)
        fill(double{});
    else
        fill(float{});
}

std::vector<double> Rig::gradient() {
    Vector full = device.make_vector("test");
    equations.get_gradient(full);
    return download(full);
}

std::vector<double> Rig::damping() {
    Vector full = device.make_vector("test");
    equations.get_damping(full);
    return download(full);
}

Vector Rig::upload(const std::vector<double>& values) {
    Vector vector = device.make_vector("test");
    device.upload(values.data(), vector);
    return vector;
}

Vector Rig::upload_reduced(const std::vector<double>& values) {
    Vector vector = device.make_reduced_vector("test");
    device.upload(values.data(), vector);
    return vector;
}

std::vector<double> Rig::download(const Vector& vector) {
    std::vector<double> values(static_cast<size_t>(device.layout().num_parameters(problem_)));
    device.download(vector, values.data());
    return values;
}

std::vector<double> Rig::download_reduced(const Vector& vector) {
    std::vector<double> values(static_cast<size_t>(device.layout().num_f));
    vector.f.read(values.data(), vector.f.bytes());
    return values;
}

std::vector<std::vector<double>> Rig::image_matrices(const Buffer& packed) {
    std::vector<double> values(packed.bytes() / sizeof(double));
    packed.read(values.data(), packed.bytes());
    std::vector<std::vector<double>> matrices;
    size_t next = 0;
    for (const ParameterBlock& block : device.layout().blocks) {
        const auto n = static_cast<size_t>(block.size);
        auto& matrix = matrices.emplace_back(n * n, 0.0);
        for (size_t row = 0; row < n; ++row)
            for (size_t k = 0; k <= row; ++k) matrix[row * n + k] = values[next++];
    }
    return matrices;
}

std::vector<double> Rig::point_values(const std::vector<Buffer>& rows, size_t num_rows) {
    std::vector<double> of_points(num_rows * problem_.points.size(), 0.0);
    for (size_t c = 0; c < rows.size(); ++c) {
        const std::vector<int32_t>& slot_point = device.tiles().chunks[c].slot_point;
        const auto read = [&](auto&& values) {
            for (size_t slot = 0; slot < slot_point.size(); ++slot)
                for (size_t k = 0; slot_point[slot] >= 0 && k < num_rows; ++k)
                    of_points[num_rows * static_cast<size_t>(slot_point[slot]) + k] =
                        static_cast<double>(
                            values[static_cast<int64_t>(k * slot_point.size() + slot)]);
        };
        if (precision == Precision::mixed)
            read(rows[c].map_read<float>());
        else
            read(rows[c].map_read<double>());
    }
    return of_points;
}

std::vector<double> Rig::point_matrices(const std::vector<Buffer>& rows) {
    constexpr size_t places[] = {0, 3, 4, 6, 7, 8};  // of xx, yx, yy, zx, zy, zz
    const std::vector<double> values = point_values(rows, 6);
    std::vector<double> matrices(9 * problem_.points.size(), 0.0);
    for (size_t p = 0; p < problem_.points.size(); ++p)
        for (size_t k = 0; k < 6; ++k) matrices[9 * p + places[k]] = values[6 * p + k];
    return matrices;
}

std::vector<double> Rig::point_blocks() {
    const std::vector<double> roots = point_matrices(equations.point_roots);
    std::vector<double> blocks(roots.size(), 0.0);
    for (size_t at = 0; at < roots.size(); at += 9)
        for (size_t row = 0; row < 3; ++row)
            for (size_t column = 0; column < 3; ++column)
                for (size_t k = 0; k < 3; ++k)
                    blocks[at + 3 * row + column] +=
                        roots[at + 3 * row + k] * roots[at + 3 * column + k];
    return blocks;
}

std::vector<double> Rig::scales() {
    std::vector<double> scales = device.layout().scale;
    for (int32_t p = 0; p < problem_.num_points(); ++p)
        for (double c : point_scale(problem_, p)) scales.push_back(c);
    return scales;
}

}  // namespace clba::test
