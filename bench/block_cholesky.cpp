// SPDX-License-Identifier: Apache-2.0
// Factorisations and solutions of reduced camera systems on the host, of blocks of 9: by
// BlockCholesky, by Eigen's dense LLT and by CHOLMOD through the plug-in that CLBA_CHOLMOD names.
//   bench/block_cholesky [--benchmark_filter=...]
// dense: 356 images that all share points. street: 2000 images, each with the 20 before and after
// it. places: 3000 images in the plane, each with about 40 others near it.
// CLBA_BENCH_THREADS: number of threads of BlockCholesky; unset: those of the machine.
#include <benchmark/benchmark.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "linear/block_cholesky.hpp"
#include "reference/sparse_cholesky.hpp"

namespace {

using namespace clba;

constexpr int32_t block_size = 9;

template <class Connected>
BlockPattern make_pattern(int32_t num_blocks, const Connected& connected) {
    BlockPattern pattern;
    pattern.block_size.assign(num_blocks, block_size);
    pattern.row_begin = {0};
    for (int32_t row = 0; row < num_blocks; ++row) {
        for (int32_t column = 0; column <= row; ++column)
            if (row == column || connected(row, column)) pattern.columns.push_back(column);
        pattern.row_begin.push_back(static_cast<int64_t>(pattern.columns.size()));
    }
    return pattern;
}

BlockPattern dense_pattern() {
    return make_pattern(356, [](int32_t, int32_t) { return true; });
}

BlockPattern street_pattern() {
    return make_pattern(2000, [](int32_t row, int32_t column) { return row - column <= 20; });
}

BlockPattern places_pattern() {
    constexpr int32_t num_blocks = 3000;
    constexpr double radius = 0.065;  // pi radius^2 num_blocks = 40
    std::mt19937 random(1);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::vector<std::pair<double, double>> places(num_blocks);
    for (auto& [x, y] : places) {
        x = uniform(random);
        y = uniform(random);
    }
    return make_pattern(num_blocks, [&](int32_t row, int32_t column) {
        const double dx = places[row].first - places[column].first;
        const double dy = places[row].second - places[column].second;
        return dx * dx + dy * dy <= radius * radius;
    });
}

// Random blocks with a diagonal above the sum of what is beside it in its row.
std::vector<double> make_values(const BlockPattern& pattern) {
    std::mt19937 random(2);
    std::uniform_real_distribution<double> uniform(-1, 1);
    std::vector<double> values(pattern.columns.size() * block_size * block_size);
    for (double& value : values) value = uniform(random);
    std::vector<int> num_entries(pattern.num_blocks(), 0);
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k) {
            ++num_entries[row];
            ++num_entries[pattern.columns[k]];
        }
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int i = 0; i < block_size; ++i)
            values[(pattern.row_begin[row + 1] - 1) * block_size * block_size +
                   i * (block_size + 1)] = block_size * num_entries[row];
    return values;
}

int bench_threads() {
    const char* value = std::getenv("CLBA_BENCH_THREADS");
    return value && *value ? std::stoi(value)
                           : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

void report_flops(benchmark::State& state, double flops) {
    state.counters["GFlop/s"] =
        benchmark::Counter(flops / 1e9, benchmark::Counter::kIsIterationInvariantRate);
}

template <class Real>
struct Fixture {
    explicit Fixture(const BlockPattern& pattern)
        : cholesky(pattern, bench_threads()), b(cholesky.num_rows(), Real(1)), x(b) {
        const std::vector<double> in_double = make_values(pattern);
        values.assign(in_double.begin(), in_double.end());
    }
    BlockCholesky<Real> cholesky;
    std::vector<Real> values, b, x;
};

template <class Real>
void factorize(benchmark::State& state, BlockPattern (*make)()) {
    Fixture<Real> fixture(make());
    for (auto _ : state)
        if (!fixture.cholesky.factorize(fixture.values.data()))
            state.SkipWithError("not positive definite");
    report_flops(state, fixture.cholesky.factor_flops());
}

template <class Real>
void solve(benchmark::State& state, BlockPattern (*make)()) {
    Fixture<Real> fixture(make());
    if (!fixture.cholesky.factorize(fixture.values.data()))
        state.SkipWithError("not positive definite");
    for (auto _ : state) {
        fixture.cholesky.solve(fixture.b.data(), fixture.x.data());
        benchmark::DoNotOptimize(fixture.x.data());
    }
    // The factor is read twice.
    state.SetBytesProcessed(state.iterations() * fixture.cholesky.num_factor_values() * 2 *
                            static_cast<int64_t>(sizeof(Real)));
}

void analyze(benchmark::State& state, BlockPattern (*make)()) {
    const BlockPattern pattern = make();
    for (auto _ : state) benchmark::DoNotOptimize(BlockCholesky<double>(pattern, bench_threads()));
}

void estimate(benchmark::State& state, BlockPattern (*make)()) {
    const BlockPattern pattern = make();
    for (auto _ : state) benchmark::DoNotOptimize(estimate_flops(pattern));
}

template <class Real>
void eigen_dense(benchmark::State& state) {
    using Matrix = Eigen::Matrix<Real, Eigen::Dynamic, Eigen::Dynamic>;
    const int n = dense_pattern().num_blocks() * block_size;
    Matrix matrix = Matrix::Random(n, n);
    matrix.diagonal().setConstant(Real(2 * n));
    Eigen::LLT<Matrix, Eigen::Lower> llt(n);
    for (auto _ : state) llt.compute(matrix);
    report_flops(state, elimination_flops(n, 0));
}

void cholmod_factorize(benchmark::State& state, BlockPattern (*make)()) {
    const BlockPattern pattern = make();
    const std::vector<double> values = make_values(pattern);
    const int64_t num_rows = int64_t{pattern.num_blocks()} * block_size;
    std::vector<std::vector<std::pair<int64_t, double>>> columns(num_rows);
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k)
            for (int64_t i = 0; i < block_size; ++i)
                for (int64_t j = 0; j < block_size; ++j) {
                    const int64_t at = row * block_size + i;
                    const int64_t column = pattern.columns[k] * block_size + j;
                    if (at >= column)
                        columns[column].emplace_back(at,
                                                     values[(k * block_size + i) * block_size + j]);
                }
    std::vector<int64_t> starts = {0}, rows;
    std::vector<double> entries;
    for (const auto& column : columns) {
        for (const auto& [row, value] : column) {
            rows.push_back(row);
            entries.push_back(value);
        }
        starts.push_back(static_cast<int64_t>(rows.size()));
    }
    try {
        reference::SparseCholesky cholesky(starts, rows);
        for (auto _ : state)
            if (!cholesky.factorize(entries.data())) state.SkipWithError("not positive definite");
    } catch (const Error& error) {
        state.SkipWithError(error.what());
    }
}

template <class Function, class... Arguments>
void add(const std::string& name, const Function& function, Arguments... arguments) {
    benchmark::RegisterBenchmark(name.c_str(), function, arguments...)
        ->Unit(benchmark::kMillisecond)
        ->UseRealTime();
}

}  // namespace

int main(int argc, char** argv) {
    for (const auto& [name, make] :
         {std::pair<std::string, BlockPattern (*)()>{"dense", dense_pattern},
          {"street", street_pattern},
          {"places", places_pattern}}) {
        add("factorize/float/" + name, factorize<float>, make);
        add("factorize/double/" + name, factorize<double>, make);
        add("factorize/cholmod/" + name, cholmod_factorize, make);
        add("solve/float/" + name, solve<float>, make);
        add("solve/double/" + name, solve<double>, make);
        add("analyze/" + name, analyze, make);
        add("estimate_flops/" + name, estimate, make);
    }
    add("factorize/eigen_float/dense", eigen_dense<float>);
    add("factorize/eigen_double/dense", eigen_dense<double>);
    benchmark::Initialize(&argc, argv);
    if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
    benchmark::RunSpecifiedBenchmarks();
    benchmark::Shutdown();
    return 0;
}
