// SPDX-License-Identifier: Apache-2.0
// One context used by several threads at a time, each with a problem of its own.
#include <clba/clba.h>
#include <gtest/gtest.h>

#include <thread>

#include "api_rig.hpp"

namespace clba_test {
namespace {

// Different options take different kernels, so that threads also meet while these are built.
clba_solver_options options_of(size_t thread) {
    clba_solver_options options = solver_options();
    options.max_num_iterations = 5;
    if (thread % 2) options.linear_solver = CLBA_LINEAR_SOLVER_PCG_HESSIAN;
    return options;
}

Data solved(const Data& start, const Context& context, size_t thread) {
    const Problem problem = problem_of(start);
    const clba_summary summary = solve(problem, context, options_of(thread));
    EXPECT_LT(summary.final_cost, summary.initial_cost);
    return data_of(problem);
}

constexpr size_t num_threads = 3;

TEST(Threads, ShareAContextAndGetTheBitsOfOneAlone) {
    std::vector<Data> starts, together(num_threads);
    for (size_t i = 0; i < num_threads; ++i) starts.push_back(data_of(generate(0, 6, 40, i).start));
    // The context is new: its kernels are not there yet.
    const Context shared = make_context();
    std::vector<std::thread> threads;
    for (size_t i = 0; i < num_threads; ++i)
        threads.emplace_back([&, i] {
            EXPECT_OK(clba_context_retain(shared.get()));
            for (int repeat = 0; repeat < 2; ++repeat) together[i] = solved(starts[i], shared, i);
            clba_context_release(shared.get());
        });
    for (std::thread& thread : threads) thread.join();
    const Context alone = make_context();
    for (size_t i = 0; i < num_threads; ++i) EXPECT_EQ(together[i], solved(starts[i], alone, i));
}

TEST(Threads, MakeContextsAtTheSameTime) {
    const Data start = data_of(generate(0, 6, 40).start);
    std::vector<Data> results(num_threads);
    std::vector<std::thread> threads;
    for (size_t i = 0; i < num_threads; ++i)
        threads.emplace_back([&, i] { results[i] = solved(start, make_context(), 0); });
    for (std::thread& thread : threads) thread.join();
    for (const Data& result : results) EXPECT_EQ(result, results[0]);
}

TEST(Threads, EachHasItsOwnLastError) {
    EXPECT_NE(clba_problem_create(nullptr), CLBA_OK);
    const std::string mine = clba_last_error();
    std::string before, after;
    std::thread other([&] {
        before = clba_last_error();
        EXPECT_NE(clba_problem_set_loss(nullptr, 0, 0), CLBA_OK);
        EXPECT_NE(clba_num_devices(nullptr), CLBA_OK);
        after = clba_last_error();
    });
    other.join();
    EXPECT_EQ(before, "");
    EXPECT_NE(after, mine);
    EXPECT_EQ(clba_last_error(), mine);
}

}  // namespace
}  // namespace clba_test
