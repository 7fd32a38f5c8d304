// SPDX-License-Identifier: Apache-2.0
// Conjugate gradients on systems that are known in full: a dense A on the host, with a diagonal
// preconditioner, against Eigen.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "device_rig.hpp"
#include "linear/pcg.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double epsilon = std::numeric_limits<double>::epsilon();
constexpr double lambda = 0.25;

class PcgTest : public testing::TestWithParam<test::Shape>, protected PcgSystem {
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

    // Two parts, the second of an odd size.
    Vector make(const VectorXd& values) {
        const Eigen::Index first = values.size() / 2;
        Vector vector;
        vector.f = Buffer(*queue_, static_cast<uint64_t>(first) * sizeof(double), "test");
        vector.e.emplace_back(
            *queue_, static_cast<uint64_t>(values.size() - first) * sizeof(double), "test");
        set(vector, values);
        return vector;
    }
    static void set(Vector& vector, const VectorXd& values) {
        vector.f.write(values.data(), vector.f.bytes());
        vector.e[0].write(values.data() + vector.f.bytes() / sizeof(double), vector.e[0].bytes());
    }
    static VectorXd get(const Vector& vector) {
        const uint64_t first = vector.f.bytes() / sizeof(double);
        VectorXd values(first + vector.e[0].bytes() / sizeof(double));
        vector.f.read(values.data(), vector.f.bytes());
        vector.e[0].read(values.data() + first, vector.e[0].bytes());
        return values;
    }

    void add_product(const Vector& p, Vector& q) override {
        if (++num_products_ == cancel_at_product_) cancelled_ = true;
        set(q, get(q) + a_ * get(p));
    }
    void precondition(const Vector& r, Vector& z) override {
        set(z, preconditioner_.cwiseProduct(get(r)));
    }

    // A of n x n with eigenvalues from about 0.1 to n.
    void make_system(int n) {
        const std::vector<double> numbers = test::random_vector(n * n + n, 1);
        const Eigen::Map<const MatrixXd> random(numbers.data(), n, n);
        a_ = random * random.transpose() + 0.1 * MatrixXd::Identity(n, n);
        d2_ = VectorXd::Constant(n, 0.5) + Eigen::Map<const VectorXd>(numbers.data(), n).cwiseAbs();
        b_ = Eigen::Map<const VectorXd>(numbers.data() + n * n, n);
        full_ = a_;
        full_.diagonal() += lambda * d2_;
        preconditioner_ = full_.diagonal().cwiseInverse();
    }
    PcgResult solve(const PcgOptions& options, VectorXd& x) {
        const VectorXd unset = VectorXd::Constant(b_.size(), std::nan(""));
        Pcg pcg(options, *queue_, *vectors_, make(unset), make(unset));
        Vector device_x = make(unset), residual = make(b_);
        const PcgResult result =
            pcg.solve(*this, lambda, make(d2_), residual, device_x,
                      StopTest(&cancelled_, std::numeric_limits<double>::infinity()));
        x = get(device_x);
        return result;
    }

    std::unique_ptr<Queue> queue_;
    std::unique_ptr<VectorOperations> vectors_;
    MatrixXd a_, full_;
    VectorXd d2_, b_, preconditioner_;
    int num_products_ = 0;
    int cancel_at_product_ = -1;
    std::atomic<bool> cancelled_{false};
};

TEST_P(PcgTest, EndsWhereItIsCancelled) {
    make_system(40);
    VectorXd x;
    cancel_at_product_ = 3;
    const int interval = queue_->tuning().pcg_interval;
    const PcgResult result = solve({40, 40, 0.1}, x);
    EXPECT_EQ(result.stopped, StopCause::cancelled);
    EXPECT_EQ(result.num_iterations, (3 + interval - 1) / interval * interval);
    EXPECT_TRUE(result.is_usable);
    const VectorXd cut = x;
    // It is the iterate of as many iterations.
    cancelled_ = false;
    cancel_at_product_ = -1;
    const PcgResult limited = solve({result.num_iterations, result.num_iterations, 0.1}, x);
    EXPECT_EQ(limited.stopped, StopCause::none);
    EXPECT_EQ(cut, x);
}

TEST_P(PcgTest, SolvesASystem) {
    for (int n : {2, 3, 40, 41}) {
        make_system(n);
        VectorXd x;
        const PcgResult result = solve({2 * n, 2 * n + 4, 0.1}, x);
        EXPECT_TRUE(result.is_usable);
        const VectorXd expected = full_.llt().solve(b_);
        const double condition = full_.norm() / 0.1;
        EXPECT_LE((x - expected).norm(), 16 * n * condition * epsilon * expected.norm()) << n;
    }
}

// Iteration k improves the quadratic model Q by a share below eta / k, and none before it did.
TEST_P(PcgTest, StopsByTheQuadraticModel) {
    make_system(40);
    const auto model = [&](int iterations) {
        VectorXd x;
        const PcgResult result = solve({iterations, iterations, 0.5}, x);
        EXPECT_EQ(result.num_iterations, iterations);
        return 0.5 * x.dot(full_ * x) - b_.dot(x);
    };
    const double eta = 0.05;
    VectorXd x;
    const int stopped = solve({0, 60, eta}, x).num_iterations;
    ASSERT_GT(stopped, 2);
    ASSERT_LT(stopped, 60);
    for (int k = 2; k <= stopped; ++k) {
        const double before = model(k - 1), now = model(k);
        EXPECT_EQ(k * (now - before) / now < eta, k == stopped) << "iteration " << k;
    }
}

TEST_P(PcgTest, NothingToDo) {
    make_system(11);
    b_.setZero();
    VectorXd x;
    const PcgResult result = solve({0, 10, 0.1}, x);
    EXPECT_TRUE(result.is_usable);
    EXPECT_EQ(result.num_iterations, 0);
    EXPECT_EQ(x, VectorXd::Zero(11));
}

TEST_P(PcgTest, NegativeCurvatureEndsItAndKeepsWhatWasFound) {
    make_system(20);
    VectorXd x;
    full_ = a_ = -a_ - MatrixXd::Identity(20, 20);
    EXPECT_FALSE(solve({0, 10, 0.1}, x).is_usable);  // at once
    EXPECT_EQ(x, VectorXd::Zero(20));

    // One negative direction that the first ones hardly see.
    make_system(20);
    a_.row(19).setZero();
    a_.col(19).setZero();
    a_(19, 19) = -2;
    b_[19] = 1e-3;
    const PcgResult result = solve({20, 40, 0.1}, x);
    EXPECT_TRUE(result.is_usable);
    EXPECT_GT(result.num_iterations, 0);
    EXPECT_LT(result.num_iterations, 40);
    EXPECT_TRUE(x.allFinite());
}

TEST_P(PcgTest, NumbersThatAreNotFinite) {
    make_system(20);
    b_[7] = std::nan("");
    VectorXd x;
    EXPECT_FALSE(solve({0, 10, 0.1}, x).is_usable);
    make_system(20);
    a_(3, 4) = a_(4, 3) = std::numeric_limits<double>::infinity();
    EXPECT_FALSE(solve({0, 10, 0.1}, x).is_usable);
    make_system(20);
    preconditioner_ = -preconditioner_;
    EXPECT_FALSE(solve({0, 10, 0.1}, x).is_usable);
}

TEST_P(PcgTest, LimitOfIterations) {
    make_system(40);
    VectorXd x;
    EXPECT_EQ(solve({0, 3, 1e-12}, x).num_iterations, 3);
    EXPECT_EQ(solve({7, 30, 0.9}, x).num_iterations, 7);
}

std::vector<test::Shape> shapes() {
    std::vector<test::Shape> list = {test::device_shape(), test::group_shape(7, 3, 16, 4096)};
    if (test::is_small()) return list;
    list.push_back(test::loop_shape("plain_loops_3", false, 3, 16, 4096));
    list.push_back(test::group_shape(64, 2, 16, 4096));
    return list;
}

const auto name_of = [](const testing::TestParamInfo<test::Shape>& shape) {
    return shape.param.name;
};
INSTANTIATE_TEST_SUITE_P(Shapes, PcgTest, testing::ValuesIn(shapes()), name_of);

}  // namespace
}  // namespace clba
