// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// The observations of each image and of each point, how many images use each camera, and the images
// of each frame of rigs, for problems that grow: rows that are appended cost as much as they are,
// however large the problem is. Each list is a chain from the latest observation to the first.
class ObservationIndex {
public:
    explicit ObservationIndex(const Problem& problem) { extend(problem); }

    // Takes in the rows that were appended to the problem since.
    void extend(const Problem& problem);
    // Lists rigs anew, at the cost of the images alone.
    void list_rigs(const Problem& problem);

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
    template <class Visit>
    void for_each_of_frame(int32_t frame, Visit&& visit) const {
        for (int32_t i = of_frame_.latest[frame]; i >= 0; i = of_frame_.before[i]) visit(i);
    }
    int32_t num_sensor_users(int32_t sensor) const { return num_sensor_users_[sensor]; }

private:
    struct Chains {
        std::vector<int32_t> latest;  // item of each row, -1: none
        std::vector<int32_t> before;  // the one before each item in its chain, -1: none
        void add(int32_t row, int32_t item) {
            before.push_back(row < 0 ? -1 : latest[row]);
            if (row >= 0) latest[row] = item;
        }
    };
    Chains of_image_, of_point_;
    Chains of_frame_;  // images; nothing without rigs
    std::vector<int32_t> num_users_, num_sensor_users_;
    int32_t num_images_ = 0, num_listed_images_ = 0;  // the latter in rigs

    void extend_rigs(const Problem& problem);
};

}  // namespace clba
