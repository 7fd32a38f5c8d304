// SPDX-License-Identifier: Apache-2.0
// Cancellation, budgets and checkpoints of solves, through clba.h.
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <thread>

#include "api_rig.hpp"

namespace clba_test {
namespace {

namespace fs = std::filesystem;

struct ReleaseCancellation {
    void operator()(clba_cancellation* cancellation) const {
        clba_cancellation_release(cancellation);
    }
};
using Cancellation = std::unique_ptr<clba_cancellation, ReleaseCancellation>;

Cancellation make_cancellation() {
    clba_cancellation* cancellation = nullptr;
    EXPECT_OK(clba_cancellation_create(&cancellation));
    return Cancellation(cancellation);
}

// Options that go on for as long as they are left to.
clba_solver_options endless_options() {
    clba_solver_options options = solver_options();
    options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 0;
    options.max_num_iterations = 1000000;
    return options;
}

using Callback = std::function<bool(const clba_iteration&)>;  // true: stop

void call_back(clba_solver_options& options, Callback& callback) {
    options.user_data = &callback;
    options.on_iteration = [](const clba_iteration* row, void* user_data) {
        return static_cast<int32_t>((*static_cast<Callback*>(user_data))(*row));
    };
}

TEST(Cancellation, StaysUntilItIsReset) {
    const Context context = make_context();
    const Scene scene = generate();
    const Data start = data_of(scene.start);
    const Cancellation cancellation = make_cancellation();
    EXPECT_EQ(clba_cancellation_is_requested(cancellation.get()), 0);
    clba_cancellation_request(cancellation.get());
    EXPECT_NE(clba_cancellation_is_requested(cancellation.get()), 0);
    clba_solver_options options = solver_options();
    options.cancellation = cancellation.get();
    for (int i = 0; i < 2; ++i) {
        const clba_summary summary = solve(scene.start, context, options);
        EXPECT_EQ(summary.termination, CLBA_USER_STOP);
        EXPECT_EQ(summary.reason, CLBA_REASON_CANCELLED);
        EXPECT_EQ(summary.num_iterations, 0);
        EXPECT_EQ(summary.final_cost, summary.initial_cost);
        EXPECT_TRUE(data_of(scene.start) == start);
    }
    clba_cancellation_reset(cancellation.get());
    EXPECT_EQ(solve(scene.start, context, options).termination, CLBA_CONVERGENCE);
    clba_cancellation_request(nullptr);
    clba_cancellation_reset(nullptr);
    EXPECT_EQ(clba_cancellation_is_requested(nullptr), 0);
    EXPECT_TRUE(refused(clba_cancellation_create(nullptr), {"cancellation", "NULL"}));
}

TEST(Cancellation, ComesFromAnotherThreadAndMayBeReleasedMeanwhile) {
    const Context context = make_context();
    const Scene scene = generate();
    Cancellation cancellation = make_cancellation();
    clba_solver_options options = endless_options();
    options.cancellation = cancellation.get();
    std::thread other;
    Callback callback = [&](const clba_iteration& row) {
        if (row.iteration == 2)
            other = std::thread([&] {
                clba_cancellation_request(cancellation.get());
                cancellation.reset();
            });
        if (row.iteration == 5) other.join();
        return false;
    };
    call_back(options, callback);
    const clba_summary summary = solve(scene.start, context, options);
    if (other.joinable()) other.join();
    EXPECT_EQ(summary.reason, CLBA_REASON_CANCELLED) << summary.message;
    EXPECT_GE(summary.num_iterations, 2);
    EXPECT_LE(summary.num_iterations, 5);
    EXPECT_LT(summary.final_cost, summary.initial_cost);
    EXPECT_NEAR(cost_of(scene.start, context), summary.reference_final_cost,
                1e-9 * summary.final_cost);
}

// The second solve, whose kernels are built, spends its time in a step of up to 10^6 iterations.
TEST(Budgets, TimeEndsALongStepAndKeepsTheBestState) {
    const Context context = make_context();
    const Scene scene = generate(0, 24, 120), again = generate(0, 24, 120);
    clba_solver_options options = endless_options();
    options.linear_solver = CLBA_LINEAR_SOLVER_PCG_HESSIAN;
    options.eta = 1e-300;
    options.max_num_iterations = 1;
    options.max_linear_solver_iterations = 1;
    solve(again.start, context, options);
    options.max_num_iterations = 1000000;
    options.max_linear_solver_iterations = 1000000;
    options.max_seconds = 0.3;
    const clba_summary summary = solve(scene.start, context, options);
    EXPECT_EQ(summary.reason, CLBA_REASON_MAX_SECONDS) << summary.message;
    EXPECT_EQ(summary.termination, CLBA_NO_CONVERGENCE);
    EXPECT_LE(summary.final_cost, summary.initial_cost);
    EXPECT_NEAR(cost_of(scene.start, context), summary.final_cost, 1e-9 * summary.final_cost);
}

class Checkpoints : public testing::Test {
protected:
    Checkpoints() {
        static int counter = 0;
        folder_ = fs::path(testing::TempDir()) /
                  ("clba_control_" + std::to_string(::getpid()) + "_" + std::to_string(counter++));
        fs::create_directory(folder_);
        path_ = (folder_ / "solve.checkpoint").string();
    }
    ~Checkpoints() override { fs::remove_all(folder_); }

    struct Solved {
        clba_summary summary{};
        std::vector<clba_iteration> rows;
        Data data;
    };
    Solved run(const clba_solver_options& options) {
        const Scene scene = generate(0.02, 10, 80);
        clba_result* made = nullptr;
        EXPECT_OK(clba_problem_solve(scene.start.get(), context_.get(), &options, &made));
        const Result result(made);
        Solved solved;
        solved.summary.struct_size = sizeof solved.summary;
        EXPECT_OK(clba_result_get_summary(made, &solved.summary));
        solved.rows.resize(static_cast<size_t>(clba_result_num_rows(made)));
        for (size_t i = 0; i < solved.rows.size(); ++i) {
            solved.rows[i].struct_size = sizeof solved.rows[i];
            EXPECT_OK(clba_result_get_row(made, static_cast<int32_t>(i), &solved.rows[i]));
        }
        solved.data = data_of(scene.start);
        return solved;
    }

    static void expect_same(const Solved& a, const Solved& b) {
        EXPECT_TRUE(a.data == b.data);
        EXPECT_EQ(a.summary.initial_cost, b.summary.initial_cost);
        EXPECT_EQ(a.summary.final_cost, b.summary.final_cost);
        EXPECT_EQ(a.summary.reason, b.summary.reason);
        EXPECT_EQ(a.summary.linear_solver, b.summary.linear_solver);
        EXPECT_STREQ(a.summary.choice, b.summary.choice);
        EXPECT_EQ(a.summary.num_accepted_steps, b.summary.num_accepted_steps);
        EXPECT_EQ(a.summary.num_rejected_steps, b.summary.num_rejected_steps);
        EXPECT_EQ(a.summary.num_invalid_steps, b.summary.num_invalid_steps);
        EXPECT_EQ(a.summary.num_linear_solver_iterations, b.summary.num_linear_solver_iterations);
        ASSERT_EQ(a.rows.size(), b.rows.size());
        for (size_t i = 0; i < a.rows.size(); ++i) {
            EXPECT_EQ(a.rows[i].iteration, static_cast<int32_t>(i));
            EXPECT_EQ(a.rows[i].cost, b.rows[i].cost) << i;
            EXPECT_EQ(a.rows[i].gradient_max_norm, b.rows[i].gradient_max_norm) << i;
            EXPECT_EQ(a.rows[i].step_norm, b.rows[i].step_norm) << i;
            EXPECT_EQ(a.rows[i].trust_region_radius, b.rows[i].trust_region_radius) << i;
            EXPECT_EQ(a.rows[i].step_is_accepted, b.rows[i].step_is_accepted) << i;
        }
    }

    std::string content() const {
        std::ifstream file(path_, std::ios::binary);
        return {std::istreambuf_iterator<char>(file), {}};
    }
    void write(const std::string& bytes) const {
        std::ofstream(path_, std::ios::binary | std::ios::trunc) << bytes;
    }

    Context context_ = make_context();
    fs::path folder_;
    std::string path_;
};

struct Method {
    int32_t linear_solver, damping, precision;
    double eta;
};

TEST_F(Checkpoints, ASolveGoesOnToTheSameBits) {
    const Method methods[] = {
        {CLBA_LINEAR_SOLVER_AUTO, CLBA_DAMPING_MARQUARDT, CLBA_PRECISION_MIXED, 1e-9},
        {CLBA_LINEAR_SOLVER_PCG_HESSIAN, CLBA_DAMPING_LEVENBERG, CLBA_PRECISION_DOUBLE, 0},
        {CLBA_LINEAR_SOLVER_PCG_SCHUR, CLBA_DAMPING_MARQUARDT, CLBA_PRECISION_SINGLE, 0},
        {CLBA_LINEAR_SOLVER_EXPLICIT_SCHUR, CLBA_DAMPING_UNCERTAINTY, CLBA_PRECISION_MIXED, 0}};
    for (const Method& method : methods) {
        SCOPED_TRACE(clba_linear_solver_name(method.linear_solver));
        clba_solver_options options = solver_options();
        options.linear_solver = method.linear_solver;
        options.damping = method.damping;
        options.precision = method.precision;
        options.eta = method.eta;
        options.function_tolerance = 1e-9;
        options.max_num_iterations = 9;
        const Solved whole = run(options);
        const bool is_auto = method.linear_solver == CLBA_LINEAR_SOLVER_AUTO;
        EXPECT_EQ(whole.summary.linear_solver,
                  is_auto ? CLBA_LINEAR_SOLVER_EXPLICIT_SCHUR : method.linear_solver);
        for (const int32_t cut : {1, 3, 6}) {
            SCOPED_TRACE(cut);
            if (cut >= whole.summary.num_iterations) break;
            clba_solver_options first = options;
            first.max_num_iterations = cut;
            first.checkpoint_path = path_.c_str();
            const Solved begun = run(first);
            EXPECT_EQ(begun.summary.num_checkpoints, 1);
            clba_solver_options second = options;
            second.resume_path = path_.c_str();
            const Solved resumed = run(second);
            EXPECT_EQ(resumed.summary.resumed_iteration, cut);
            expect_same(whole, resumed);
            EXPECT_GE(resumed.rows.back().seconds, begun.rows.back().seconds);
        }
    }
}

TEST_F(Checkpoints, AreWrittenAsOftenAsAsked) {
    clba_solver_options options = solver_options();
    options.checkpoint_path = path_.c_str();
    options.checkpoint_every = 2;
    options.max_num_iterations = 5;
    options.function_tolerance = 0;
    std::vector<bool> exists;
    Callback callback = [&](const clba_iteration&) {
        exists.push_back(fs::exists(path_));
        return false;
    };
    call_back(options, callback);
    const Solved solved = run(options);
    // After iterations 2 and 4, and at the end.
    EXPECT_EQ(exists, (std::vector<bool>{false, false, false, true, true, true}));
    EXPECT_EQ(solved.summary.num_checkpoints, 3);
    EXPECT_STREQ(solved.summary.checkpoint_error, "");
    EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
}

TEST_F(Checkpoints, EveryEndThatIsNotFinalLeavesOne) {
    clba_solver_options options = solver_options();
    options.function_tolerance = 1e-9;
    const Solved whole = run(options);
    const Cancellation cancellation = make_cancellation();
    for (const bool cancels : {false, true}) {
        clba_solver_options first = options;
        first.checkpoint_path = path_.c_str();
        first.checkpoint_every = 0;
        first.cancellation = cancellation.get();
        Callback callback = [&](const clba_iteration& row) {
            if (row.iteration == 2 && cancels) clba_cancellation_request(cancellation.get());
            return row.iteration == 2 && !cancels;
        };
        call_back(first, callback);
        EXPECT_EQ(run(first).summary.termination, CLBA_USER_STOP);
        clba_solver_options second = options;
        second.resume_path = path_.c_str();
        const Solved resumed = run(second);
        EXPECT_EQ(resumed.summary.resumed_iteration, 2);
        expect_same(whole, resumed);
    }
}

TEST_F(Checkpoints, ThatCannotBeWrittenAreReported) {
    clba_solver_options options = solver_options();
    const std::string absent = (folder_ / "absent" / "file").string();
    options.checkpoint_path = absent.c_str();
    const Scene scene = generate();
    const Data start = data_of(scene.start);
    EXPECT_TRUE(refused(clba_problem_solve(scene.start.get(), context_.get(), &options, nullptr),
                        CLBA_ERROR_FILE, {absent.c_str(), "folder"}));
    EXPECT_TRUE(data_of(scene.start) == start);
    // Lost in the middle: the solve goes on to its end.
    fs::create_directory(folder_ / "absent");
    options.checkpoint_every = 1;
    Callback callback = [&](const clba_iteration& row) {
        if (row.iteration == 2) fs::remove_all(folder_ / "absent");
        return false;
    };
    call_back(options, callback);
    const clba_summary summary = solve(scene.start, context_, options);
    EXPECT_EQ(summary.termination, CLBA_CONVERGENCE);
    EXPECT_EQ(summary.num_checkpoints, 1);
    EXPECT_NE(std::string(summary.checkpoint_error).find("absent"), std::string::npos);
}

TEST_F(Checkpoints, ThatDoNotFitAreRefused) {
    clba_solver_options options = solver_options();
    options.max_num_iterations = 2;
    options.checkpoint_path = path_.c_str();
    run(options);
    const std::string good = content();
    clba_solver_options resume = solver_options();
    resume.resume_path = path_.c_str();

    const Scene scene = generate(0.02, 10, 80);
    const Data start = data_of(scene.start);
    const auto refuses = [&](const clba_solver_options& given, clba_status status,
                             std::initializer_list<const char*> parts) {
        EXPECT_TRUE(refused(clba_problem_solve(scene.start.get(), context_.get(), &given, nullptr),
                            status, parts));
        EXPECT_TRUE(data_of(scene.start) == start);
    };
    for (const size_t length : {size_t{0}, size_t{5}, size_t{8}, size_t{20}, good.size() - 1}) {
        write(good.substr(0, length));
        refuses(resume, CLBA_ERROR_FORMAT, {path_.c_str()});
    }
    for (const size_t at : {size_t{17}, good.size() / 2, good.size() - 3}) {
        std::string bad = good;
        bad[at] = static_cast<char>(bad[at] ^ 1);
        write(bad);
        refuses(resume, CLBA_ERROR_FORMAT, {path_.c_str(), "damaged"});
    }
    write("CLBACKPT" + std::string(1, 9) + good.substr(9));
    refuses(resume, CLBA_ERROR_FORMAT, {"version 9", "version 1"});
    write(good);
    clba_solver_options other = resume;
    other.damping = CLBA_DAMPING_LEVENBERG;
    refuses(other, CLBA_ERROR_INVALID_ARGUMENT, {path_.c_str(), "another damping"});
    other = resume;
    other.linear_solver = CLBA_LINEAR_SOLVER_PCG_SCHUR;
    refuses(other, CLBA_ERROR_INVALID_ARGUMENT, {"another linear_solver"});
    EXPECT_OK(clba_problem_set_loss(scene.start.get(), CLBA_LOSS_HUBER, 3));
    refuses(resume, CLBA_ERROR_INVALID_ARGUMENT, {"another problem"});
    other.resume_path = "";
    refuses(other, CLBA_ERROR_INVALID_ARGUMENT, {"resume_path is empty"});
    fs::remove(path_);
    refuses(resume, CLBA_ERROR_FILE, {path_.c_str(), "No such file"});
}

}  // namespace
}  // namespace clba_test
