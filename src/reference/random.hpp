// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

namespace clba::scene {

// The standard fixes the numbers of mt19937_64, not those of its distributions.
class Random {
public:
    // Equal seeds give streams of different numbers their own sequences.
    Random(uint64_t seed, uint64_t stream) : engine_(mixed(mixed(seed) + stream)) {}

    double uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
    double uniform(double low, double high) { return low + (high - low) * uniform(); }
    int32_t below(int32_t count) {
        return static_cast<int32_t>(engine_() % static_cast<uint64_t>(count));
    }
    // Standard normal (Box and Muller).
    double normal() {
        if (has_spare_) {
            has_spare_ = false;
            return spare_;
        }
        const double radius = std::sqrt(-2 * std::log(1 - uniform()));
        const double angle = 2 * 3.14159265358979323846 * uniform();
        spare_ = radius * std::sin(angle);
        has_spare_ = true;
        return radius * std::cos(angle);
    }
    // Isotropic normal whose root mean square length is 1.
    Eigen::Vector3d normal_vector() {
        Eigen::Vector3d v;
        for (int k = 0; k < 3; ++k) v[k] = normal() / std::sqrt(3.0);
        return v;
    }
    // Number of failures before the first success, with the given mean.
    int32_t geometric(double mean) {
        if (mean <= 0) return 0;
        const double failures = std::log(1 - uniform()) / std::log(mean / (1 + mean));
        return static_cast<int32_t>(std::min(failures, 1e9));
    }

private:
    static uint64_t mixed(uint64_t x) {  // splitmix64's finaliser
        x += 0x9e3779b97f4a7c15u;
        x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
        x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
        return x ^ (x >> 31);
    }

    std::mt19937_64 engine_;
    double spare_ = 0;
    bool has_spare_ = false;
};

}  // namespace clba::scene
