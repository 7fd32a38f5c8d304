// SPDX-License-Identifier: Apache-2.0
// Kernels over vectors against plain loops.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "device_rig.hpp"
#include "linear/vector.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double epsilon = std::numeric_limits<double>::epsilon();

// Lengths of the parts of a vector. A group has 1024 elements or more.
using Sizes = std::vector<int>;

std::vector<Sizes> all_sizes() {
    if (test::is_small()) return {{0}, {1}, {63}, {64, 65}, {1025}, {7, 0, 2053}};
    return {{0},    {1},    {63},    {64},      {65},         {1023},       {1025},
            {2053}, {8209}, {65, 1}, {3, 1025}, {7, 0, 2053}, {0, 64, 8209}};
}

class VectorTest : public testing::TestWithParam<test::Shape> {
protected:
    void SetUp() override {
        const auto context = test::test_context();
        test::set_shape(*context, GetParam());
        queue_ = std::make_unique<Queue>(context);
        vectors_ = std::make_unique<VectorOperations>(*queue_, Precision::mixed);
    }
    void TearDown() override {
        vectors_.reset();
        queue_.reset();
    }

    static std::vector<double> values(const Sizes& sizes, uint64_t seed) {
        return test::random_vector(std::accumulate(sizes.begin(), sizes.end(), int64_t{0}), seed);
    }
    Vector upload(const Sizes& sizes, const std::vector<double>& values) {
        Vector vector;
        size_t next = 0;
        for (size_t i = 0; i < sizes.size(); ++i) {
            const uint64_t bytes = static_cast<uint64_t>(sizes[i]) * sizeof(double);
            Buffer buffer(*queue_, bytes, "test");
            buffer.write(values.data() + next, bytes);
            next += static_cast<size_t>(sizes[i]);
            if (i == 0)
                vector.f = std::move(buffer);
            else
                vector.e.push_back(std::move(buffer));
        }
        return vector;
    }
    static std::vector<double> download(const Vector& vector) {
        std::vector<double> values;
        for (size_t i = 0; i < vector.num_parts(); ++i) {
            const size_t n = vector.part(i).bytes() / sizeof(double);
            values.resize(values.size() + n);
            vector.part(i).read(values.data() + values.size() - n, n * sizeof(double));
        }
        return values;
    }

    template <class Check>
    void for_all_sizes(const Check& check) {
        for (const Sizes& sizes : all_sizes()) {
            std::string trace = "sizes";
            for (int size : sizes) trace += " " + std::to_string(size);
            SCOPED_TRACE(trace);
            check(sizes, values(sizes, 1), values(sizes, 2));
        }
    }
    static void expect_sum(double sum, const std::vector<double>& terms) {
        double wanted = 0, size = 0;
        for (double term : terms) {
            wanted += term;
            size += std::abs(term);
        }
        EXPECT_NEAR(sum, wanted, epsilon * static_cast<double>(terms.size()) * size);
    }
    // a is a sum of two or three products b.
    static void expect_near(const std::vector<double>& a, const std::vector<double>& b) {
        ASSERT_EQ(a.size(), b.size());
        for (size_t i = 0; i < a.size(); ++i)  // of numbers up to 4
            ASSERT_TRUE(std::abs(a[i] - b[i]) <= 16 * epsilon) << i << ": " << a[i] << ' ' << b[i];
    }

    std::unique_ptr<Queue> queue_;
    std::unique_ptr<VectorOperations> vectors_;
};

TEST_P(VectorTest, DotProduct) {
    for_all_sizes([&](const Sizes& sizes, auto x, auto y) {
        std::vector<double> terms;
        for (size_t i = 0; i < x.size(); ++i) terms.push_back(x[i] * y[i]);
        const Vector device_x = upload(sizes, x), device_y = upload(sizes, y);
        const double dot = vectors_->dot(device_x, device_y);
        expect_sum(dot, terms);
        EXPECT_EQ(vectors_->dot(device_x, device_y), dot) << "two runs";
    });
}

TEST_P(VectorTest, ReducedArgumentsLeaveOutThePoints) {
    const Sizes sizes = {70, 1030};
    const std::vector<double> x = values(sizes, 1), y = values(sizes, 2);
    const std::vector<double> reduced(x.begin(), x.begin() + 70);
    std::vector<double> terms, wanted = reduced;
    for (size_t i = 0; i < 70; ++i) {
        terms.push_back(x[i] * y[i]);
        wanted[i] += 2 * y[i];
    }
    Vector device_x = upload({70}, reduced);
    const Vector device_y = upload(sizes, y);
    expect_sum(vectors_->dot(device_x, device_y), terms);
    vectors_->scale_and_add(2, device_y, 1, device_x);
    expect_near(download(device_x), wanted);
}

TEST_P(VectorTest, SquaredNormOfDoubles) {
    for_all_sizes([&](const Sizes& sizes, auto x, auto) {
        std::vector<double> terms;
        for (int i = 0; i < sizes[0]; ++i) terms.push_back(x[i] * x[i]);
        expect_sum(vectors_->squared_norm(upload(sizes, x).f), terms);
    });
}

TEST_P(VectorTest, RealsAndTheirSquaredNorm) {
    for_all_sizes([&](const Sizes& sizes, auto x, auto) {
        const Vector device_x = upload(sizes, x);
        Vector back = upload(sizes, std::vector<double>(x.size(), nan));
        std::vector<Buffer> reals;
        for (size_t i = 0; i < sizes.size(); ++i) {
            reals.emplace_back(*queue_, device_x.part(i).bytes() / 2, "test");
            vectors_->to_real(device_x.part(i), reals.back());
            vectors_->from_real(reals.back(), back.part(i));
        }
        std::vector<double> terms;
        for (double& value : x) {
            value = static_cast<double>(static_cast<float>(value));
            terms.push_back(value * value);
        }
        EXPECT_EQ(download(back), x);
        expect_sum(vectors_->squared_norm(reals), terms);
    });
}

TEST_P(VectorTest, LargestMagnitude) {
    for_all_sizes([&](const Sizes& sizes, auto x, auto) {
        double wanted = 0;
        for (double value : x) wanted = std::max(wanted, std::abs(value));
        EXPECT_EQ(vectors_->max_abs(upload(sizes, x)), wanted);
        if (x.empty()) return;
        for (size_t at : {size_t{0}, x.size() / 2, x.size() - 1}) {
            std::vector<double> planted = x;
            planted[at] = -3;
            EXPECT_EQ(vectors_->max_abs(upload(sizes, planted)), 3) << "at " << at;
            planted[at] = nan;
            EXPECT_EQ(vectors_->max_abs(upload(sizes, planted)), infinity) << "at " << at;
            planted[at] = -infinity;
            EXPECT_EQ(vectors_->max_abs(upload(sizes, planted)), infinity) << "at " << at;
        }
    });
}

TEST_P(VectorTest, ScaleAndAdd) {
    for_all_sizes([&](const Sizes& sizes, auto x, auto y) {
        const Vector device_x = upload(sizes, x);
        Vector device_y = upload(sizes, y);
        vectors_->scale_and_add(2, device_x, -0.5, device_y);
        for (size_t i = 0; i < x.size(); ++i) y[i] = 2 * x[i] - 0.5 * y[i];
        expect_near(download(device_y), y);
        Vector unset = upload(sizes, std::vector<double>(x.size(), nan));
        vectors_->scale_and_add(-1, device_x, 0, unset);
        for (double& value : x) value = -value;
        EXPECT_EQ(download(unset), x);
    });
}

TEST_P(VectorTest, MaskOfConstants) {
    for_all_sizes([&](const Sizes& sizes, auto x, auto scale) {
        for (double& value : scale) value = std::max(value, 0.0);
        Vector device_x = upload(sizes, x);
        const Vector device_scale = upload(sizes, scale);
        for (size_t i = 0; i < sizes.size(); ++i)
            vectors_->mask_constants(device_scale.part(i), device_x.part(i));
        for (size_t i = 0; i < x.size(); ++i)
            if (scale[i] == 0) x[i] = 0;
        EXPECT_EQ(download(device_x), x);
    });
}

std::vector<test::Shape> shapes() {
    std::vector<test::Shape> list = {test::device_shape(),
                                     test::loop_shape("plain_loops_3", false, 3, 16, 4096),
                                     test::group_shape(7, 3, 16, 4096)};
    if (test::is_small()) return list;
    list.push_back(test::loop_shape("vector_loops_1", true, 1, 16, 4096));
    list.push_back(test::loop_shape("vector_loops_8", true, 8, 16, 4096));
    for (int size : {1, 2, 63, 64, 65}) list.push_back(test::group_shape(size, 8, 16, 4096));
    return list;
}

const auto name_of = [](const testing::TestParamInfo<test::Shape>& shape) {
    return shape.param.name;
};
INSTANTIATE_TEST_SUITE_P(Shapes, VectorTest, testing::ValuesIn(shapes()), name_of);

}  // namespace
}  // namespace clba
