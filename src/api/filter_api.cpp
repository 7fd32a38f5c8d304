// SPDX-License-Identifier: Apache-2.0
// Reprojection errors, and the removal of outliers.
#include <algorithm>
#include <cmath>

#include "api/handles.hpp"
#include "problem/removal.hpp"
#include "reference/bundle.hpp"
#include "reference/outliers.hpp"

namespace clba {
namespace {

clba_filter_options default_filter_options() {
    const OutlierRules defaults;
    clba_filter_options options{};
    options.struct_size = sizeof options;
    options.error_unit = CLBA_UNIT_PIXELS;
    options.remove_behind = defaults.remove_behind;
    options.min_num_views = defaults.min_views;
    options.max_reprojection_error = defaults.max_error;
    options.min_triangulation_angle = defaults.min_angle;
    return options;
}

void require_unit(int32_t unit, const char* name) {
    require(clba_unit_name(unit) != nullptr, name, " = ", unit, ", but the units are ",
            int{CLBA_UNIT_PIXELS}, " and ", int{CLBA_UNIT_SIGMAS});
}

OutlierRules outlier_rules(const clba_filter_options& given) {
    require_unit(given.error_unit, "error_unit");
    require(given.max_reprojection_error > 0,
            "max_reprojection_error = ", given.max_reprojection_error, ", but it must be > 0");
    require(given.min_triangulation_angle >= 0 && given.min_triangulation_angle < 180,
            "min_triangulation_angle = ", given.min_triangulation_angle,
            ", but it must be in [0, 180) degrees");
    require(given.min_num_views >= 0, "min_num_views = ", given.min_num_views,
            ", but it must be >= 0");
    require(given.reserved == 0, "reserved = ", given.reserved, ", but it must be 0");
    OutlierRules rules;
    rules.in_sigmas = given.error_unit == CLBA_UNIT_SIGMAS;
    rules.max_error = given.max_reprojection_error;
    rules.min_angle = given.min_triangulation_angle;
    rules.min_views = given.min_num_views;
    rules.remove_behind = given.remove_behind != 0;
    return rules;
}

// Which rows have an observation.
std::vector<uint8_t> observed(const Problem& problem, size_t num_rows,
                              int32_t Observation::*row_of) {
    std::vector<uint8_t> is_observed(num_rows, 0);
    for (const Observation& observation : problem.observations)
        is_observed[observation.*row_of] = 1;
    return is_observed;
}

// Removes, and fills the report but for the reasons; false: nothing went. Changes nothing if it
// throws.
bool remove(Reconstruction& reconstruction, const std::vector<uint8_t>& goes, bool removes_points,
            clba_filter_report& out) {
    const Problem& problem = reconstruction.problem;
    const std::vector<uint8_t> images_before =
        observed(problem, problem.images.size(), &Observation::image);
    const std::vector<uint8_t> points_before =
        observed(problem, problem.points.size(), &Observation::point);
    std::vector<uint8_t> images_after(problem.images.size(), 0),
        points_after(points_before.size(), 0);
    for (size_t i = 0; i < goes.size(); ++i) {
        if (goes[i]) continue;
        images_after[problem.observations[i].image] = 1;
        points_after[problem.observations[i].point] = 1;
    }
    for (size_t p = 0; p < points_before.size(); ++p)
        out.num_points_unobserved += points_before[p] && !points_after[p];
    const int64_t num_observations = problem.num_observations();
    const int32_t num_points = problem.num_points();
    const RowMaps maps = remove_observations(reconstruction, goes, removes_points);
    out.num_observations_removed = num_observations - problem.num_observations();
    out.num_points_removed = num_points - problem.num_points();
    for (size_t i = 0; i < images_before.size(); ++i) {
        const bool is_lost = images_before[i] && !images_after[i];
        out.num_images_unobserved += is_lost;
        if (out.unobserved_images) out.unobserved_images[i] = is_lost;
    }
    if (out.observation_rows)
        std::copy(maps.observations.begin(), maps.observations.end(), out.observation_rows);
    if (out.point_rows) std::copy(maps.points.begin(), maps.points.end(), out.point_rows);
    return out.num_observations_removed > 0 || out.num_points_removed > 0;
}

// The caller's report with its arrays, and no counts.
clba_filter_report arrays_of(const clba_filter_report* report) {
    clba_filter_report none{};
    none.struct_size = sizeof none;
    const clba_filter_report given = copied_in(report, none, "report");
    none.observation_rows = given.observation_rows;
    none.point_rows = given.point_rows;
    none.unobserved_images = given.unobserved_images;
    return none;
}

}  // namespace
}  // namespace clba

using namespace clba;

const char* clba_unit_name(int32_t unit) {
    switch (unit) {
        case CLBA_UNIT_PIXELS:
            return "pixels";
        case CLBA_UNIT_SIGMAS:
            return "sigmas";
        default:
            return nullptr;
    }
}

clba_status clba_problem_get_reprojection_errors(const clba_problem* problem, int32_t unit,
                                                 int64_t first, int64_t count, double* errors,
                                                 size_t stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_unit(unit, "unit");
        const Problem& p = problem->problem;
        require_range(first, count, p.num_observations(), "observations");
        const Rows rows(errors, stride, 1, "errors", count);
        reference::visit_errors(
            p, first, count, [&](int64_t i, const reference::ReprojectionError& error) {
                rows.set(i - first, 0, unit == CLBA_UNIT_SIGMAS ? error.sigmas : error.pixels);
            });
    });
}

clba_status clba_filter_options_init(clba_filter_options* options, size_t struct_size) {
    return guarded([&] { init_struct(options, struct_size, default_filter_options(), "options"); });
}

clba_status clba_problem_filter(clba_problem* problem, const clba_filter_options* options,
                                clba_filter_report* report) {
    return changed(problem, [&](Problem& p) {
        const clba_filter_options given = copied_in(options, default_filter_options(), "options");
        clba_filter_report out = arrays_of(report);
        const Outliers outliers = find_outliers(p, outlier_rules(given));
        const auto number = [&](OutlierReason reason) {
            return outliers.num_observations[static_cast<size_t>(reason)];
        };
        out.num_behind = number(OutlierReason::behind);
        out.num_large_error = number(OutlierReason::large_error);
        out.num_few_views = number(OutlierReason::few_views);
        out.num_small_angle = number(OutlierReason::small_angle);
        out.num_points_few_views = outliers.num_points_few_views;
        out.num_points_small_angle = outliers.num_points_small_angle;
        const bool is_other_structure =
            remove(problem->reconstruction, outliers.reasons, given.remove_points != 0, out);
        if (report) copy_out(out, report, "report");
        return is_other_structure;
    });
}

clba_status clba_problem_remove_observations(clba_problem* problem, int64_t count,
                                             const int32_t* flags, size_t stride,
                                             int32_t remove_points, clba_filter_report* report) {
    return changed(problem, [&](Problem& p) {
        require_count(count, p.num_observations(), "observations");
        const Rows rows(flags, stride, 1, "flags", count);
        clba_filter_report out = arrays_of(report);
        std::vector<uint8_t> goes(static_cast<size_t>(count));
        for (int64_t i = 0; i < count; ++i) goes[i] = rows.get(i) != 0;
        const bool is_other_structure =
            remove(problem->reconstruction, goes, remove_points != 0, out);
        if (report) copy_out(out, report, "report");
        return is_other_structure;
    });
}
