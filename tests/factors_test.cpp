// SPDX-License-Identifier: Apache-2.0
// Inverse factors of planted blocks: failures are counted and leave zeros, and nothing else fails.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "base/error.hpp"
#include "device_rig.hpp"
#include "reference/bundle.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double lambda = 0.5;

// A block with its damping and scales, lambda D^2 not yet added.
struct Block {
    RowMajorMatrix a;
    std::vector<double> d2, scale;
    int size() const { return static_cast<int>(a.rows()); }
};

// Well-conditioned with a unit diagonal or thereabouts, except that each kind of trouble comes up:
// negative pivots, zeros, NaN and infinities on and off the diagonal, in free and in constant rows.
std::vector<Block> planted_blocks(const std::vector<int>& sizes) {
    std::vector<Block> blocks;
    for (size_t b = 0; b < sizes.size(); ++b) {
        const int n = sizes[b];
        const std::vector<double> numbers = test::random_vector(n * n + 2 * n, b + 1);
        const Eigen::Map<const RowMajorMatrix> random(numbers.data(), n, n);
        Block block;
        block.a = random * random.transpose() / n;
        for (int k = 0; k < n; ++k) {
            block.d2.push_back(1 + 0.5 * numbers[static_cast<size_t>(n * n + k)]);
            const bool is_constant =
                b % 3 == 1 && numbers[static_cast<size_t>(n * n + n + k)] > 0.4;
            block.scale.push_back(is_constant ? 0.0 : 2.0);
        }
        const int row = static_cast<int>(b) % n, column = static_cast<int>(b / 2) % n;
        const auto set = [&](int i, int k, double value) {
            block.a(i, k) = value;
            block.a(k, i) = value;
        };
        if (b % 17 == 3) set(row, row, -8);
        if (b % 17 == 6 && n > 1 && row != column) set(row, column, 9);
        if (b % 17 == 9) set(row, column, nan);
        if (b % 17 == 12) set(row, column, infinity);
        if (b % 17 == 14) set(row, row, -lambda * block.d2[static_cast<size_t>(row)]);
        blocks.push_back(std::move(block));
    }
    return blocks;
}

struct Twin {
    std::vector<RowMajorMatrix> factors;
    int64_t num_failures = 0;
};

Twin twin_factors(const std::vector<Block>& blocks) {
    Twin twin;
    for (const Block& block : blocks) {
        RowMajorMatrix a = block.a;
        for (int k = 0; k < block.size(); ++k) a(k, k) += lambda * block.d2[static_cast<size_t>(k)];
        RowMajorMatrix g(block.size(), block.size());
        if (!reference::inverse_factor(block.size(), a.data(), block.scale.data(), g.data()))
            ++twin.num_failures;
        twin.factors.push_back(g);
    }
    return twin;
}

// Blocks have A >= lambda D^2 >= 1/4 and |A| <= 14 or so, hence a condition of about 100.
void expect_equal(const RowMajorMatrix& g, const RowMajorMatrix& twin, double real_epsilon) {
    const double tolerance =
        64 * static_cast<double>(g.rows()) * real_epsilon * (1 + twin.cwiseAbs().maxCoeff());
    for (int row = 0; row < g.rows(); ++row)
        for (int k = 0; k <= row; ++k)
            ASSERT_TRUE(std::abs(g(row, k) - twin(row, k)) <= (twin(row, k) == 0 ? 0 : tolerance))
                << row << ' ' << k << ": " << g(row, k) << ", but the twin has " << twin(row, k);
}

class FactorsTest : public testing::TestWithParam<test::Shape> {
protected:
    void SetUp() override {
        const auto context = test::test_context();
        test::set_shape(*context, GetParam());
        queue_ = std::make_unique<Queue>(context);
    }
    void TearDown() override { queue_.reset(); }

    template <class Value>
    Buffer upload(const std::vector<Value>& values) {
        Buffer buffer(*queue_, values.size() * sizeof(Value), "test");
        buffer.write(values.data(), buffer.bytes());
        return buffer;
    }
    template <class Value>
    static std::vector<Value> download(const Buffer& buffer) {
        std::vector<Value> values(buffer.bytes() / sizeof(Value));
        buffer.read(values.data(), buffer.bytes());
        return values;
    }
    Kernel& kernel(const char* name) {
        return queue_->kernel("factors.cl", name, "-DREAL=float -DMAX_BLOCK=14");
    }
    int64_t num_groups(int64_t n) const {
        return std::min<int64_t>(n, queue_->tuning().vector_groups);
    }
    Buffer make_failures(int64_t groups) {
        return upload(std::vector<int32_t>(
            static_cast<size_t>(groups * queue_->tuning().work_group_size), -1));
    }
    static int64_t sum(const Buffer& failures) {
        const auto counts = download<int32_t>(failures);
        return std::accumulate(counts.begin(), counts.end(), int64_t{0});
    }

    std::unique_ptr<Queue> queue_;
};

// L of point p with a condition of about 10, except that each kind of trouble comes up: a row of
// zeros, NaN and infinities, in free and in constant rows.
RowMajorMatrix planted_root(size_t p) {
    const std::vector<double> numbers = test::random_vector(6, p + 1);
    RowMajorMatrix root = RowMajorMatrix::Zero(3, 3);
    for (int row = 0, next = 0; row < 3; ++row)
        for (int k = 0; k <= row; ++k)
            root(row, k) = static_cast<float>(numbers[static_cast<size_t>(next++)]);
    for (int k = 0; k < 3; ++k) root(k, k) = std::abs(root(k, k)) + 0.5;
    root = root.cast<float>().cast<double>();
    const int row = static_cast<int>(p) % 3;
    if (p % 17 == 3) root.row(row).setZero();
    if (p % 17 == 9) root(row, 0) = nan;
    if (p % 17 == 12) root(row, row) = infinity;
    return root;
}

// V = L L^T of planted roots, damped by the three policies: with none of V's diagonal for a point
// that has none, `marquardt` leaves a 0 there.
TEST_P(FactorsTest, PointBlocks) {
    constexpr int places[6][2] = {{0, 0}, {1, 0}, {1, 1}, {2, 0}, {2, 1}, {2, 2}};
    constexpr double smallest = 0, largest = 0.7;
    const auto launch_and_check = [&](size_t n, int32_t policy, bool has_scales) {
        SCOPED_TRACE(testing::Message()
                     << n << " points, policy " << policy << ", scales " << has_scales);
        std::vector<Block> blocks;
        std::vector<float> roots(6 * n);
        std::vector<double> scale(3 * n), fixed(3 * n);
        for (size_t p = 0; p < n; ++p) {
            const RowMajorMatrix root = planted_root(p);
            const std::vector<double> numbers = test::random_vector(6, n + p);
            Block block;
            block.a = root * root.transpose();
            std::vector<double> diagonal, at_start;
            for (size_t k = 0; k < 3; ++k) {
                const bool is_constant = p % 3 == 1 && numbers[k] > 0.4;
                block.scale.push_back(!has_scales ? 1.0 : is_constant ? 0.0 : 2.0);
                const auto row = static_cast<int>(k);
                diagonal.push_back(block.a(row, row));
                at_start.push_back(1 + numbers[3 + k]);
                scale[k * n + p] = block.scale[k];
            }
            block.d2 = reference::damping_diagonal(policy, smallest, largest, block.scale, diagonal,
                                                   at_start);
            for (size_t k = 0; k < 3; ++k) fixed[k * n + p] = block.d2[k];
            for (size_t k = 0; k < 6; ++k)
                roots[k * n + p] = static_cast<float>(root(places[k][0], places[k][1]));
            blocks.push_back(std::move(block));
        }
        const int64_t groups = num_groups(static_cast<int64_t>(n));
        Buffer failures = make_failures(groups);
        Buffer factors = upload(std::vector<float>(6 * n, 1e9f));
        const Buffer device_roots = upload(roots), device_scale = upload(scale),
                     device_fixed = upload(fixed);
        queue_->launch(Step::vector,
                       queue_->kernel("factors.cl", "factor_point_blocks",
                                      text("-DREAL=float -DMAX_BLOCK=14 -DDAMPING=", policy,
                                           " -DSCALED_POINTS=", has_scales ? 1 : 0)),
                       groups, smallest, largest, lambda, static_cast<int32_t>(n), device_roots,
                       has_scales ? &device_scale : nullptr, policy == 2 ? &device_fixed : nullptr,
                       factors, failures);
        const Twin twin = twin_factors(blocks);
        EXPECT_EQ(sum(failures), twin.num_failures);
        EXPECT_EQ(twin.num_failures > 0, policy == 1 ? n > 3 : n > 9);
        const auto values = download<float>(factors);
        for (size_t p = 0; p < n; ++p) {
            RowMajorMatrix g = RowMajorMatrix::Zero(3, 3);
            for (size_t k = 0; k < 6; ++k)
                g(places[k][0], places[k][1]) = static_cast<double>(values[k * n + p]);
            SCOPED_TRACE(testing::Message() << "point " << p);
            expect_equal(g, twin.factors[p], test::epsilon(Precision::mixed));
        }
    };
    for (size_t n : {1, 2, 63, 64, 65, 311})
        for (int32_t policy : {1, 2, 3})
            for (bool has_scales : {true, false}) launch_and_check(n, policy, has_scales);
}

TEST_P(FactorsTest, ImageBlocks) {
    for (size_t n : {1, 13, 64, 150}) {
        SCOPED_TRACE(testing::Message() << n << " blocks");
        std::vector<int> sizes(n);
        for (size_t b = 0; b < n; ++b) sizes[b] = 1 + static_cast<int>((5 * b + 8) % 14);
        const std::vector<Block> blocks = planted_blocks(sizes);
        std::vector<int32_t> offset, size, matrix;
        std::vector<double> packed, d2, scale;
        for (const Block& block : blocks) {
            offset.push_back(static_cast<int32_t>(d2.size()));
            size.push_back(block.size());
            matrix.push_back(static_cast<int32_t>(packed.size()));
            d2.insert(d2.end(), block.d2.begin(), block.d2.end());
            scale.insert(scale.end(), block.scale.begin(), block.scale.end());
            for (int row = 0; row < block.size(); ++row)
                for (int k = 0; k <= row; ++k) packed.push_back(block.a(row, k));
        }
        const auto num_blocks = static_cast<int32_t>(n);
        const int64_t groups = num_groups(num_blocks);
        Buffer failures = make_failures(groups);
        Buffer matrices = upload(packed);
        const Buffer device_offset = upload(offset), device_size = upload(size),
                     device_matrix = upload(matrix), device_scale = upload(scale),
                     device_d2 = upload(d2);
        queue_->launch(Step::vector, kernel("factor_image_blocks"), groups, lambda, num_blocks,
                       device_offset, device_size, device_matrix, matrices, device_scale, device_d2,
                       failures);
        const Twin twin = twin_factors(blocks);
        EXPECT_EQ(sum(failures), twin.num_failures);
        EXPECT_EQ(twin.num_failures > 0, n > 3);
        const auto values = download<double>(matrices);
        for (size_t b = 0; b < n; ++b) {
            RowMajorMatrix g = RowMajorMatrix::Zero(size[b], size[b]);
            size_t next = static_cast<size_t>(matrix[b]);
            for (int row = 0; row < size[b]; ++row)
                for (int k = 0; k <= row; ++k) g(row, k) = values[next++];
            SCOPED_TRACE(testing::Message() << "block " << b << " of size " << size[b]);
            expect_equal(g, twin.factors[b], test::epsilon(Precision::double_precision));
        }
    }
}

std::vector<test::Shape> shapes() {
    std::vector<test::Shape> list = {test::device_shape(), test::group_shape(7, 3, 16, 4096)};
    if (test::is_small()) return list;
    list.push_back(test::loop_shape("plain_loops_1", false, 1, 16, 4096));
    for (int size : {1, 64, 65}) list.push_back(test::group_shape(size, 2, 16, 4096));
    return list;
}

const auto name_of = [](const testing::TestParamInfo<test::Shape>& shape) {
    return shape.param.name;
};
INSTANTIATE_TEST_SUITE_P(Shapes, FactorsTest, testing::ValuesIn(shapes()), name_of);

}  // namespace
}  // namespace clba
