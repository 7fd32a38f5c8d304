// SPDX-License-Identifier: Apache-2.0
// The block-sparse Cholesky factorisation against Eigen's dense one.
#include "linear/block_cholesky.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "linear/block_inverse.hpp"

namespace clba {
namespace {

using Edge = std::pair<int32_t, int32_t>;  // row > column

BlockPattern make_pattern(std::vector<int32_t> sizes, std::vector<Edge> edges) {
    for (size_t i = 0; i < sizes.size(); ++i)
        edges.emplace_back(static_cast<int32_t>(i), static_cast<int32_t>(i));
    std::sort(edges.begin(), edges.end());
    edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
    BlockPattern pattern;
    pattern.row_begin.assign(sizes.size() + 1, 0);
    for (const Edge& edge : edges) {
        ++pattern.row_begin[edge.first + 1];
        pattern.columns.push_back(edge.second);
    }
    for (size_t i = 0; i < sizes.size(); ++i) pattern.row_begin[i + 1] += pattern.row_begin[i];
    pattern.block_size = std::move(sizes);
    return pattern;
}

std::vector<int32_t> mixed_sizes(int32_t num_blocks, uint32_t seed) {
    std::mt19937 random(seed);
    std::vector<int32_t> sizes(num_blocks);
    for (int32_t& size : sizes) size = 3 + static_cast<int32_t>(random() % 12);
    return sizes;
}

std::vector<Edge> band(int32_t num_blocks, int32_t reach) {
    std::vector<Edge> edges;
    for (int32_t i = 0; i < num_blocks; ++i)
        for (int32_t j = std::max(0, i - reach); j < i; ++j) edges.emplace_back(i, j);
    return edges;
}

std::vector<Edge> random_edges(int32_t num_blocks, int32_t count, uint32_t seed) {
    std::mt19937 random(seed);
    std::vector<Edge> edges;
    while (static_cast<int32_t>(edges.size()) < count) {
        const auto i = static_cast<int32_t>(random() % num_blocks);
        const auto j = static_cast<int32_t>(random() % num_blocks);
        if (i > j) edges.emplace_back(i, j);
    }
    return edges;
}

std::vector<Edge> shuffled(std::vector<Edge> edges, int32_t num_blocks, uint32_t seed) {
    std::vector<int32_t> name(num_blocks);
    for (int32_t i = 0; i < num_blocks; ++i) name[i] = i;
    std::shuffle(name.begin(), name.end(), std::mt19937(seed));
    for (Edge& edge : edges) {
        const int32_t a = name[edge.first], b = name[edge.second];
        edge = {std::max(a, b), std::min(a, b)};
    }
    return edges;
}

std::vector<double> random_vector(int64_t size, uint32_t seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(-1, 1);
    std::vector<double> vector(size);
    for (double& value : vector) value = uniform(random);
    return vector;
}

struct Matrix {
    std::vector<double> values;  // of the pattern's blocks
    double max_condition;
    std::vector<double> b;
    Eigen::VectorXd exact;        // the solution of A x = b by Eigen
    std::vector<double> inverse;  // blocks of A^-1, like the values
};

// Random blocks, and on the diagonal 1 plus twice the sum of what is beside it.
Matrix random_matrix(const BlockPattern& pattern, uint32_t seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(-1, 1);
    std::vector<int64_t> begin = {0};
    for (const int32_t size : pattern.block_size) begin.push_back(begin.back() + size);
    Matrix matrix;
    Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(begin.back(), begin.back());
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k)
            for (int64_t i = begin[row]; i < begin[row + 1]; ++i)
                for (int64_t j = begin[pattern.columns[k]]; j < begin[pattern.columns[k] + 1]; ++j)
                    if (i > j) dense(i, j) = dense(j, i) = uniform(random);
    const Eigen::VectorXd beside = dense.cwiseAbs().rowwise().sum();
    dense.diagonal() = 2 * beside.array() + 1;
    // Gershgorin's circles.
    matrix.max_condition = (3 * beside.maxCoeff() + 1) / (beside.minCoeff() + 1);
    matrix.b = random_vector(begin.back(), seed);
    matrix.exact =
        dense.llt().solve(Eigen::Map<const Eigen::VectorXd>(matrix.b.data(), begin.back()));
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k)
            for (int64_t i = begin[row]; i < begin[row + 1]; ++i)
                for (int64_t j = begin[pattern.columns[k]]; j < begin[pattern.columns[k] + 1]; ++j)
                    // What is above the diagonal must not be read.
                    matrix.values.push_back(i >= j ? dense(i, j)
                                                   : std::numeric_limits<double>::quiet_NaN());
    const Eigen::MatrixXd inverse = dense.inverse();
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k)
            for (int64_t i = begin[row]; i < begin[row + 1]; ++i)
                for (int64_t j = begin[pattern.columns[k]]; j < begin[pattern.columns[k] + 1]; ++j)
                    matrix.inverse.push_back(inverse(i, j));
    return matrix;
}

template <class Real>
std::vector<Real> converted(const std::vector<double>& values) {
    return std::vector<Real>(values.begin(), values.end());
}

template <class Real>
void expect_solves(BlockCholesky<Real>& cholesky, const Matrix& matrix) {
    std::vector<Real> x = converted<Real>(matrix.b);
    ASSERT_EQ(static_cast<int64_t>(x.size()), cholesky.num_rows());
    ASSERT_EQ(static_cast<int64_t>(matrix.values.size()), cholesky.num_values());
    ASSERT_TRUE(cholesky.factorize(converted<Real>(matrix.values).data()));
    cholesky.solve(x.data(), x.data());
    double error = 0;
    for (size_t i = 0; i < x.size(); ++i)
        error = std::max(error, std::abs(static_cast<double>(x[i]) - matrix.exact[i]));
    EXPECT_LT(error, 4 * std::numeric_limits<Real>::epsilon() * matrix.max_condition *
                         matrix.exact.cwiseAbs().maxCoeff());
}

template <class Real>
void expect_inverts(BlockCholesky<Real>& cholesky, const Matrix& matrix) {
    ASSERT_TRUE(cholesky.factorize(converted<Real>(matrix.values).data()));
    std::vector<Real> values(matrix.values.size(), std::numeric_limits<Real>::quiet_NaN());
    BlockInverse<Real>(cholesky).compute(values.data());
    double error = 0, largest = 0;
    for (size_t i = 0; i < values.size(); ++i) {
        // A number that was not written is not below anything.
        const double difference = std::abs(static_cast<double>(values[i]) - matrix.inverse[i]);
        error = difference <= error ? error : difference;
        largest = std::max(largest, std::abs(matrix.inverse[i]));
    }
    EXPECT_LT(error, 4 * std::numeric_limits<Real>::epsilon() * matrix.max_condition * largest);
}

struct NamedPattern {
    std::string name;
    BlockPattern pattern;
};

std::vector<NamedPattern> patterns() {
    std::vector<NamedPattern> all;
    const auto add = [&](const char* name, std::vector<int32_t> sizes, std::vector<Edge> edges) {
        all.push_back({name, make_pattern(std::move(sizes), std::move(edges))});
    };
    for (const int32_t size : {1, 3, 9, 14, 67, 131})
        add("one_block", std::vector<int32_t>(1, size), {});
    add("diagonal", mixed_sizes(31, 1), {});
    add("dense", std::vector<int32_t>(41, 9), band(41, 41));
    add("dense_mixed", mixed_sizes(37, 2), band(37, 37));
    add("path", mixed_sizes(101, 3), band(101, 1));
    add("band", std::vector<int32_t>(127, 6), shuffled(band(127, 7), 127, 4));
    add("band_mixed", mixed_sizes(83, 5), shuffled(band(83, 4), 83, 6));
    add("sparse", mixed_sizes(71, 7), random_edges(71, 150, 8));
    std::vector<Edge> star;
    for (int32_t i = 1; i < 53; ++i) star.emplace_back(i, 0);
    add("star", mixed_sizes(53, 9), star);
    std::vector<Edge> islands = random_edges(60, 100, 10);
    for (const Edge& edge : band(40, 3)) islands.emplace_back(edge.first + 60, edge.second + 60);
    add("islands", mixed_sizes(103, 11), shuffled(islands, 103, 12));
    return all;
}

TEST(BlockCholesky, SolvesEveryPatternInEachPrecisionAndInstructionSet) {
    uint32_t seed = 20;
    for (const NamedPattern& named : patterns()) {
        const Matrix matrix = random_matrix(named.pattern, ++seed);
        for (const InstructionSet set : available_instruction_sets()) {
            SCOPED_TRACE(named.name + " with instruction set " +
                         std::to_string(static_cast<int>(set)));
            BlockCholesky<double> in_double(named.pattern, 2, 0, set);
            expect_solves(in_double, matrix);
            BlockCholesky<float> in_float(named.pattern, 2, 0, set);
            expect_solves(in_float, matrix);
        }
    }
}

TEST(BlockInverse, HasTheBlocksOfTheInverseInEachPrecisionAndInstructionSet) {
    uint32_t seed = 60;
    for (const NamedPattern& named : patterns()) {
        const Matrix matrix = random_matrix(named.pattern, ++seed);
        for (const InstructionSet set : available_instruction_sets()) {
            for (const int num_threads : {1, 3}) {
                SCOPED_TRACE(named.name + " with instruction set " +
                             std::to_string(static_cast<int>(set)));
                BlockCholesky<double> in_double(named.pattern, num_threads, 0, set);
                expect_inverts(in_double, matrix);
                BlockCholesky<float> in_float(named.pattern, num_threads, 0, set);
                expect_inverts(in_float, matrix);
            }
        }
    }
}

// Large enough that threads share fronts and tiles.
TEST(BlockInverse, BitsDoNotDependOnTheNumberOfThreads) {
    const BlockPattern pattern = make_pattern(mixed_sizes(150, 71), random_edges(150, 900, 72));
    const Matrix matrix = random_matrix(pattern, 73);
    std::vector<std::vector<double>> inverses;
    for (const int num_threads : {1, 2, 5}) {
        BlockCholesky<double> cholesky(pattern, num_threads, 4);
        expect_inverts(cholesky, matrix);
        inverses.emplace_back(matrix.values.size());
        BlockInverse<double>(cholesky).compute(inverses.back().data());
    }
    EXPECT_EQ(inverses[0], inverses[1]);
    EXPECT_EQ(inverses[0], inverses[2]);
}

TEST(BlockCholesky, PivotsAreWhatEliminationLeaves) {
    const BlockPattern pattern = make_pattern({2, 1}, {{1, 0}});
    BlockCholesky<double> cholesky(pattern, 1);
    // [4 2 2; 2 5 3; 2 3 6] = L L^T with L = [2 0 0; 1 2 0; 1 1 2], in any order the same product.
    ASSERT_TRUE(cholesky.factorize(std::vector<double>{4, 2, 2, 5, 2, 3, 6}.data()));
    std::vector<double> pivots(3);
    cholesky.get_pivots(pivots.data());
    EXPECT_NEAR(pivots[0] * pivots[1] * pivots[2], 64, 1e-13);
    for (const double pivot : pivots) EXPECT_GT(pivot, 0);
}

TEST(BlockCholesky, FactorsMatrixAfterMatrix) {
    const BlockPattern pattern = make_pattern(mixed_sizes(59, 31), band(59, 6));
    BlockCholesky<double> cholesky(pattern, 2);
    for (uint32_t seed = 32; seed < 36; ++seed)
        expect_solves(cholesky, random_matrix(pattern, seed));
}

template <class Real>
std::vector<Real> solution(BlockCholesky<Real>& cholesky, const Matrix& matrix) {
    std::vector<Real> x = converted<Real>(matrix.b);
    EXPECT_TRUE(cholesky.factorize(converted<Real>(matrix.values).data()));
    cholesky.solve(x.data(), x.data());
    return x;
}

// Large enough that threads share fronts, tiles and the loops of the solution.
template <class Real>
void expect_equal_bits(const BlockPattern& pattern) {
    const Matrix matrix = random_matrix(pattern, 41);
    BlockCholesky<Real> alone(pattern, 1, 4);
    const std::vector<Real> expected = solution(alone, matrix);
    for (const int num_threads : {1, 2, 3}) {
        BlockCholesky<Real> cholesky(pattern, num_threads, 4);
        for (int repeat = 0; repeat < 3; ++repeat) {
            const std::vector<Real> x = solution(cholesky, matrix);
            EXPECT_EQ(std::memcmp(x.data(), expected.data(), x.size() * sizeof(Real)), 0)
                << num_threads << " threads, run " << repeat;
        }
    }
}

TEST(BlockCholesky, GivesEqualBitsForEveryNumberOfThreads) {
    const BlockPattern dense = make_pattern(std::vector<int32_t>(97, 9), band(97, 97));
    expect_equal_bits<float>(dense);
    expect_equal_bits<double>(dense);
    const BlockPattern street =
        make_pattern(std::vector<int32_t>(211, 9), shuffled(band(211, 12), 211, 42));
    expect_equal_bits<float>(street);
    expect_equal_bits<double>(street);
    expect_equal_bits<double>(make_pattern(mixed_sizes(173, 43), random_edges(173, 600, 44)));
}

TEST(BlockCholesky, RefusesWhatIsNotPositiveDefiniteAndStaysUsable) {
    for (const NamedPattern& named : patterns()) {
        SCOPED_TRACE(named.name);
        const BlockPattern& pattern = named.pattern;
        const Matrix matrix = random_matrix(pattern, 50);
        BlockCholesky<double> cholesky(pattern, 2);
        const int32_t middle = pattern.num_blocks() / 2;
        const int64_t diagonal = cholesky.value_offset(pattern.row_begin[middle + 1] - 1);
        const int64_t last = pattern.block_size[middle] * pattern.block_size[middle] - 1;
        for (const double bad : {-1.0, 0.0, std::numeric_limits<double>::quiet_NaN(),
                                 std::numeric_limits<double>::infinity()}) {
            std::vector<double> values = matrix.values;
            values[diagonal + last] = bad;
            EXPECT_FALSE(cholesky.factorize(values.data())) << bad;
        }
        if (pattern.row_begin[middle + 1] - pattern.row_begin[middle] > 1) {
            std::vector<double> values = matrix.values;
            values[diagonal - 1] = std::numeric_limits<double>::quiet_NaN();
            EXPECT_FALSE(cholesky.factorize(values.data())) << "off the diagonal";
        }
        expect_solves(cholesky, matrix);
    }
}

TEST(BlockCholesky, FlushesSubnormalsOnlyWhileItWorks) {
    const BlockPattern pattern = make_pattern(std::vector<int32_t>(40, 9), band(40, 2));
    BlockCholesky<float> cholesky(pattern, 2);
    solution(cholesky, random_matrix(pattern, 55));
    const volatile float smallest = std::numeric_limits<float>::min();
    const volatile float half = smallest / 2;
    EXPECT_GT(half, 0);
}

TEST(BlockCholesky, CountsTheFactorOfADenseMatrix) {
    const BlockPattern pattern = make_pattern(std::vector<int32_t>(20, 9), band(20, 20));
    const BlockCholesky<double> cholesky(pattern, 1);
    EXPECT_EQ(cholesky.num_factor_values(), 180 * 181 / 2);
    EXPECT_DOUBLE_EQ(cholesky.factor_flops(), 180.0 * 180 * 180 / 3);
    EXPECT_NEAR(estimate_flops(pattern), cholesky.factor_flops(), 1e-12 * 180 * 180 * 180);
}

TEST(BlockCholesky, FindsAnOrderWithoutFillForAPathAndAStar) {
    std::vector<Edge> star;
    for (int32_t i = 1; i < 300; ++i) star.emplace_back(i, 0);
    const std::vector<int32_t> sizes(300, 6);
    for (const std::vector<Edge>& edges : {shuffled(band(300, 1), 300, 60), star}) {
        // Of 300 blocks all but the last have one block below them.
        const double flops = 299 * elimination_flops(6, 6) + elimination_flops(6, 0);
        EXPECT_NEAR(estimate_flops(make_pattern(sizes, edges)), flops, 1e-12 * flops);
    }
}

TEST(BlockCholesky, RefusesPatternsThatBreakTheRules) {
    const BlockPattern good = make_pattern({3, 4, 5}, {{1, 0}, {2, 0}, {2, 1}});
    EXPECT_NO_THROW(BlockCholesky<double>(good, 1));
    const auto expect_refused = [](const BlockPattern& pattern) {
        EXPECT_THROW(BlockCholesky<double>(pattern, 1), Error);
        EXPECT_THROW(estimate_flops(pattern), Error);
    };
    BlockPattern bad = good;
    bad.block_size[1] = 0;
    expect_refused(bad);
    bad = good;
    bad.columns[3] = 1;  // row 2: 1, 1, 2
    expect_refused(bad);
    bad = good;
    bad.columns.back() = 1;  // no diagonal
    expect_refused(bad);
    bad = good;
    bad.row_begin.pop_back();
    expect_refused(bad);
    EXPECT_THROW(BlockCholesky<double>(good, 0), Error);
    bad = good;
    bad.columns[0] = -1;
    expect_refused(bad);
    bad = good;
    bad.columns.push_back(2);
    expect_refused(bad);
}

TEST(BlockCholesky, TakesAnEmptyPattern) {
    BlockPattern empty;
    empty.row_begin = {0};
    BlockCholesky<float> cholesky(empty, 2);
    EXPECT_EQ(cholesky.num_rows(), 0);
    EXPECT_TRUE(cholesky.factorize(nullptr));
    cholesky.solve(nullptr, nullptr);
}

}  // namespace
}  // namespace clba
