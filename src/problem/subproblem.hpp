// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/observation_index.hpp"
#include "problem/problem.hpp"

namespace clba {

// Rows of a problem, each list ascending. They must be closed: images of the observations, cameras
// of the images.
struct RowSelection {
    std::vector<int32_t> cameras, images, points, observations;
};

// The problem of these rows, in their order, with all that belongs to a row, and the loss.
Problem select_rows(const Problem& problem, const RowSelection& rows);

// What is refined of a map, while the rest stays.
struct Window {
    std::vector<int32_t> images;
    std::vector<int32_t> points;         // counts only if all_points is false
    bool all_points = true;              // that the images see
    bool refine_shared_cameras = false;  // that images outside the window use too
};

// The window's images and points with all the observations that they take part in. What these refer
// to besides is constant: images outside the window that see its points, points outside it that its
// images see, and cameras that images outside use.
struct Subproblem {
    RowSelection rows;
    Problem problem;
    int32_t num_constant_images = 0, num_free_points = 0;
};

// Costs as much as the window, its points' tracks included. Throws where the window names a row
// that does not exist or names it twice.
Subproblem extract(const Problem& problem, const ObservationIndex& index, const Window& window);

// Copies the state back that a solve may have changed. It changes nothing else of the problem.
void write_state_back(const Subproblem& from, Problem& problem);

}  // namespace clba
