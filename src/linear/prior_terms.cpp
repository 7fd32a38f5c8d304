// SPDX-License-Identifier: Apache-2.0
#include "linear/prior_terms.hpp"

#include <algorithm>
#include <numeric>

#include "linear/rig_tangents.hpp"

namespace clba {

PriorTerms::PriorTerms(DeviceProblem& device, const Problem& problem)
    : device_(device),
      queue_(device.queue()),
      defines_(precision_defines(device.precision())),
      has_points_(!problem.priors.points.empty()),
      image_priors_(problem, device.layout()),
      images_(problem.images),
      cameras_(problem.cameras),
      sensors_(problem.rigs.sensors.size()),
      step_(static_cast<size_t>(device.layout().num_f)) {
    rows_ = Buffer(queue_, image_priors_.rows(), "priors");
    row_begin_ = Buffer(queue_, image_priors_.row_begin(), "priors");
    columns_ = Buffer(queue_, image_priors_.columns(), "priors");
    device_values_ =
        Buffer(queue_, image_priors_.columns().size() * wide_bytes(device.precision()), "priors");
    list_block_targets();
    if (!image_priors_.rows().empty()) sum_ = device.make_reduced_vector("priors");
    if (has_points_) upload_points(problem);
    int64_t num_partials = 0;
    for (const Points& points : points_) num_partials += num_groups(points.num_priors);
    partials_.resize(static_cast<size_t>(num_partials));
    device_partials_ =
        Buffer(queue_, partials_.size() * wide_bytes(device.precision()), "sums of priors");
}

Kernel& PriorTerms::kernel(const char* name) {
    return queue_.kernel("priors.cl", name, defines_);
}

int64_t PriorTerms::num_groups(int64_t n) const {
    constexpr int64_t priors_per_group = 256;  // fewer are not worth a group
    return std::min<int64_t>(queue_.tuning().vector_groups,
                             (n + priors_per_group - 1) / priors_per_group);
}

// P has entries of diagonal blocks of the layout, and others, which the preconditioner leaves out.
void PriorTerms::list_block_targets() {
    const ParameterLayout& layout = device_.layout();
    std::vector<int32_t> block_of(static_cast<size_t>(layout.num_f));
    for (int32_t b = 0; b < device_.num_blocks(); ++b)
        std::fill_n(block_of.begin() + layout.blocks[b].offset, layout.blocks[b].size, b);
    std::vector<int32_t> targets, sources;
    for (size_t i = 0; i < image_priors_.rows().size(); ++i) {
        const int32_t scalar = image_priors_.rows()[i];
        const ParameterBlock& block = layout.blocks[block_of[scalar]];
        for (int32_t k = image_priors_.row_begin()[i]; k < image_priors_.row_begin()[i + 1]; ++k) {
            const int32_t column = image_priors_.columns()[k];
            if (column < block.offset || column > scalar) continue;
            const int32_t row_of_block = scalar - block.offset;
            targets.push_back(block.matrix + row_of_block * (row_of_block + 1) / 2 + column -
                              block.offset);
            sources.push_back(k);
        }
    }
    num_block_values_ = static_cast<int32_t>(targets.size());
    block_targets_ = Buffer(queue_, targets, "priors");
    block_sources_ = Buffer(queue_, sources, "priors");
}

void PriorTerms::upload_points(const Problem& problem) {
    std::vector<int32_t> prior_of(problem.points.size(), -1);
    for (size_t k = 0; k < problem.priors.points.size(); ++k)
        prior_of[problem.priors.points[k].point] = static_cast<int32_t>(k);
    for (const Chunk& chunk : device_.tiles().chunks) {
        std::vector<int32_t> slots;
        std::vector<const PointPrior*> listed;
        for (size_t slot = 0; slot < chunk.slot_point.size(); ++slot) {
            const int32_t point = chunk.slot_point[slot];
            if (point < 0 || prior_of[point] < 0) continue;
            slots.push_back(static_cast<int32_t>(slot));
            listed.push_back(&problem.priors.points[prior_of[point]]);
        }
        Points points;
        points.num_priors = static_cast<int32_t>(slots.size());
        std::vector<int32_t> prior_of_slot(chunk.slot_point.size(), points.num_priors);
        for (int32_t k = 0; k < points.num_priors; ++k) prior_of_slot[slots[k]] = k;
        points.slots = Buffer(queue_, slots, "priors of points");
        points.prior_of_slot = Buffer(queue_, prior_of_slot, "priors of points");
        const int64_t row_size = points.num_priors + 1;
        with_wide(device_.precision(), [&](auto wide) {
            using Wide = decltype(wide);
            std::vector<Wide> values(
                static_cast<size_t>((6 + 3 * position_parts(device_.precision())) * row_size));
            for (int64_t k = 0; k < points.num_priors; ++k) {
                int64_t row = 0;
                for (int r = 0; r < 3; ++r)
                    for (int c = 0; c <= r; ++c)
                        values[row++ * row_size + k] =
                            static_cast<Wide>(listed[k]->whitening[3 * r + c]);
                for (int axis = 0; axis < 3; ++axis)
                    split_position(listed[k]->position[axis], &values[(row + axis) * row_size + k],
                                   3 * row_size);
            }
            points.values = Buffer(queue_, values, "priors of points");
        });
        points_.push_back(std::move(points));
    }
}

template <class Launch>
double PriorTerms::sum_points(Launch&& launch) {
    int32_t num_partials = 0;
    for (size_t c = 0; c < points_.size(); ++c) {
        const int64_t groups = num_groups(points_[c].num_priors);
        launch(points_[c], c, groups, num_partials);
        num_partials += static_cast<int32_t>(groups);
    }
    device_.read_wide(device_partials_, partials_, partials_.size());
    return std::accumulate(partials_.begin(), partials_.end(), 0.0);
}

// From the device's numbers alone: digits that the host had beyond them would make a difference
// between a first and a second solve from the same start.
void PriorTerms::read_state(const State& state) {
    for (Image& image : images_) image.pose = Pose();
    for (Camera& camera : cameras_) camera.params.fill(0);
    device_.download_images(state, images_, cameras_);
}

double PriorTerms::cost(const State& state) {
    double cost = 0;
    if (!image_priors_.rows().empty()) {
        read_state(state);
        cost = image_priors_.cost(images_, cameras_);
    }
    if (!has_points_) return cost;
    return cost + sum_points([&](const Points& points, size_t c, int64_t groups, int32_t first) {
               queue_.launch(Step::residual, kernel("point_cost"), groups, points.num_priors,
                             points.slots, points.values, device_.chunks()[c].num_point_slots,
                             state.points[c], first, device_partials_, queue_.scratch());
           });
}

void PriorTerms::linearize(Vector& gradient, Vector& diagonal) {
    if (image_priors_.rows().empty()) return;
    read_state(device_.state);
    std::vector<double> of_priors;
    if (const RigTangents* rigs = device_.rigs())
        sensors_ = rigs->download_sensors(device_.state, std::vector<Pose>(sensors_.size()));
    image_priors_.linearize(images_, cameras_, sensors_, of_priors, values_);
    device_.write_wide(values_, device_values_);
    device_.write_wide(of_priors, sum_.f);
    device_.vectors().scale_and_add(1.0, sum_, 1.0, gradient);
    std::fill(of_priors.begin(), of_priors.end(), 0.0);
    for (size_t i = 0; i < image_priors_.rows().size(); ++i)
        for (int32_t k = image_priors_.row_begin()[i]; k < image_priors_.row_begin()[i + 1]; ++k)
            if (image_priors_.columns()[k] == image_priors_.rows()[i])
                of_priors[image_priors_.rows()[i]] = values_[k];
    device_.write_wide(of_priors, sum_.f);
    device_.vectors().scale_and_add(1.0, sum_, 1.0, diagonal);
}

void PriorTerms::add_image_product(const Buffer& x, Buffer& y) {
    const auto num_rows = static_cast<int32_t>(image_priors_.rows().size());
    queue_.launch(Step::vector, kernel("add_image_product"), num_groups(num_rows), num_rows, rows_,
                  row_begin_, columns_, device_values_, x, y);
}

void PriorTerms::add_point_product(const std::vector<Buffer>& x, std::vector<Buffer>& y) {
    for (size_t c = 0; c < points_.size(); ++c)
        queue_.launch(Step::vector, kernel("add_point_product"), num_groups(points_[c].num_priors),
                      points_[c].num_priors, points_[c].slots, points_[c].values,
                      device_.chunks()[c].num_point_slots, x[c], y[c]);
}

void PriorTerms::add_image_blocks(Buffer& packed) {
    queue_.launch(Step::preconditioner, kernel("add_image_blocks"), num_groups(num_block_values_),
                  num_block_values_, block_targets_, block_sources_, device_values_, packed);
}

double PriorTerms::squared_norm(const Vector& step, const std::vector<Buffer>& point_step) {
    double sum = 0;
    if (!image_priors_.rows().empty()) {
        device_.read_wide(step.f, step_, step_.size());
        for (size_t i = 0; i < image_priors_.rows().size(); ++i) {
            double product = 0;
            for (int32_t k = image_priors_.row_begin()[i]; k < image_priors_.row_begin()[i + 1];
                 ++k)
                product += values_[k] * step_[image_priors_.columns()[k]];
            sum += step_[image_priors_.rows()[i]] * product;
        }
    }
    if (!has_points_) return sum;
    return sum + sum_points([&](const Points& points, size_t c, int64_t groups, int32_t first) {
               queue_.launch(Step::vector, kernel("point_squared_norm"), groups, points.num_priors,
                             points.slots, points.values, device_.chunks()[c].num_point_slots,
                             point_step[c], first, device_partials_, queue_.scratch());
           });
}

}  // namespace clba
