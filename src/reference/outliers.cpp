// SPDX-License-Identifier: Apache-2.0
#include "reference/outliers.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>

#include "base/parallel.hpp"
#include "problem/point_order.hpp"
#include "reference/bundle.hpp"

namespace clba {
namespace {

constexpr int64_t grain = 1 << 12;

void set_reason(uint8_t& reason, OutlierReason value) {
    reason = static_cast<uint8_t>(value);
}

// The rays of a point's observations that no rule has removed yet, one an image.
class Rays {
public:
    Rays(const Problem& problem, const std::vector<Point>& centers)
        : problem_(problem), centers_(centers) {}

    void collect(const Visibility& visibility, int32_t point, const std::vector<uint8_t>& reasons) {
        images_.clear();
        for (const Sight& sight : visibility.of_point(point))
            if (!reasons[sight.observation]) images_.push_back(sight.image);
        std::sort(images_.begin(), images_.end());
        images_.erase(std::unique(images_.begin(), images_.end()), images_.end());
        directions_.clear();
        for (const int32_t image : images_) {
            const Point& x = problem_.points[point];
            const Point& c = centers_[image];
            Point ray{x[0] - c[0], x[1] - c[1], x[2] - c[2]};
            const double length = std::hypot(ray[0], ray[1], ray[2]);
            if (length > 0)
                for (double& value : ray) value /= length;
            directions_.push_back(ray);
        }
    }
    int32_t num_views() const { return static_cast<int32_t>(images_.size()); }

    // Whether two rays enclose an angle of at least a, given the chord 2 sin(a / 2) between their
    // unit vectors: it keeps its digits where the angle is small, as the cosine does not.
    bool enclose(double chord) const {
        for (size_t i = 0; i < directions_.size(); ++i) {
            for (size_t k = 0; k < i; ++k) {
                const Point &a = directions_[i], &b = directions_[k];
                if (std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]) >= chord) return true;
            }
        }
        return false;
    }

private:
    const Problem& problem_;
    const std::vector<Point>& centers_;
    std::vector<int32_t> images_;
    std::vector<Point> directions_;
};

}  // namespace

Outliers find_outliers(const Problem& problem, const OutlierRules& rules) {
    Outliers outliers;
    outliers.reasons.assign(problem.observations.size(), 0);
    reference::visit_errors(
        problem, 0, problem.num_observations(),
        [&](int64_t i, const reference::ReprojectionError& error) {
            uint8_t& reason = outliers.reasons[i];
            if (rules.remove_behind && (error.is_behind || error.is_singular))
                set_reason(reason, OutlierReason::behind);
            // True for NaN too.
            else if (!((rules.in_sigmas ? error.sigmas : error.pixels) <= rules.max_error))
                set_reason(reason, OutlierReason::large_error);
        });

    if (rules.min_views > 0 || rules.min_angle > 0) {
        constexpr double radians_per_degree = 3.14159265358979323846 / 180;
        const double chord = 2 * std::sin(rules.min_angle * radians_per_degree / 2);
        const Visibility visibility(problem);
        std::vector<Point> centers;
        centers.reserve(problem.images.size());
        for (const Image& image : problem.images) centers.push_back(camera_center(image.pose));
        std::mutex mutex;  // guards the counts of points
        parallel_ranges(problem.num_points(), grain, [&](int64_t begin, int64_t end) {
            Rays rays(problem, centers);
            int32_t num_few_views = 0, num_small_angle = 0;
            for (auto point = static_cast<int32_t>(begin); point < end; ++point) {
                if (!problem.constant_points.empty() && problem.constant_points[point]) continue;
                rays.collect(visibility, point, outliers.reasons);
                if (rays.num_views() == 0) continue;
                OutlierReason reason = OutlierReason::none;
                if (rays.num_views() < rules.min_views) {
                    reason = OutlierReason::few_views;
                    ++num_few_views;
                } else if (rules.min_angle > 0 && !rays.enclose(chord)) {
                    reason = OutlierReason::small_angle;
                    ++num_small_angle;
                }
                for (const Sight& sight : visibility.of_point(point))
                    if (!outliers.reasons[sight.observation])
                        set_reason(outliers.reasons[sight.observation], reason);
            }
            const std::lock_guard lock(mutex);
            outliers.num_points_few_views += num_few_views;
            outliers.num_points_small_angle += num_small_angle;
        });
    }
    for (const uint8_t reason : outliers.reasons) ++outliers.num_observations[reason];
    return outliers;
}

}  // namespace clba
