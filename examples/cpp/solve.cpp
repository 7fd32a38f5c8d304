// SPDX-License-Identifier: Apache-2.0
// Solves a BAL file in two goes: a callback stops the first, the second runs to the end.
//
//     c++ -std=c++17 solve.cpp $(pkg-config --cflags --libs clba) -o solve && ./solve FILE
#include <clba/clba.hpp>
#include <cstdio>
#include <cstdlib>
#include <exception>

namespace {

void print(const clba::Iteration& row) {
    std::printf("%3d  cost %.6e\n", row.iteration, row.cost);
}

void solve(const char* file) {
    clba::check_version();
    clba::Problem problem = clba::Problem::read_bal(file);
    const clba::Context context;

    const clba::Result stopped = problem.solve(context, {}, [](const clba::Iteration& row) {
        print(row);
        return row.iteration == 3 ? clba::Next::stop : clba::Next::go_on;
    });
    const clba::Summary half_way = stopped.summary();
    if (half_way.termination != CLBA_USER_STOP)
        throw std::runtime_error(std::string("not stopped by the callback: ") + half_way.message);
    std::printf("stopped at %.16e\n", half_way.final_cost);

    // It goes on from the state that the first solve left.
    const clba::Result result = problem.solve(context, {}, [](const clba::Iteration& row) {
        print(row);
        return clba::Next::go_on;
    });
    std::printf("%s", result.report().data());
    std::printf("final cost %.16e\n", result.summary().final_cost);
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 2) {
        std::fprintf(stderr, "usage: solve FILE\n");
        return EXIT_FAILURE;
    }
    try {
        solve(argv[1]);
        return EXIT_SUCCESS;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return EXIT_FAILURE;
    }
}
