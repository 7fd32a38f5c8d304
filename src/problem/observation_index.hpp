// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// The observations of each image and of each point, and how many images use each camera, for
// problems that grow: rows that are appended cost as much as they are, however large the problem
// is. Each list is a chain from the latest observation to the first.
class ObservationIndex {
public:
    explicit ObservationIndex(const Problem& problem) { extend(problem); }

    // Takes in the rows that were appended to the problem since.
    void extend(const Problem& problem);

    // visit(observation), the latest first.
    template <class Visit>
    void for_each_of_image(int32_t image, Visit&& visit) const {
        for (int32_t i = of_image_.latest[image]; i >= 0; i = of_image_.before[i]) visit(i);
    }
    template <class Visit>
    void for_each_of_point(int32_t point, Visit&& visit) const {
        for (int32_t i = of_point_.latest[point]; i >= 0; i = of_point_.before[i]) visit(i);
    }
    int32_t num_users(int32_t camera) const { return num_users_[camera]; }

private:
    struct Chains {
        std::vector<int32_t> latest;  // observation of each image or point, -1: none
        std::vector<int32_t> before;  // the one before each observation in its chain, -1: none
        void add(int32_t row, int32_t observation) {
            before.push_back(latest[row]);
            latest[row] = observation;
        }
    };
    Chains of_image_, of_point_;
    std::vector<int32_t> num_users_;
    int32_t num_images_ = 0;
};

}  // namespace clba
