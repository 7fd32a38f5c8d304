// SPDX-License-Identifier: Apache-2.0
#include "api/report.hpp"

#include <cstdarg>
#include <cstdio>

#include "api/json_writer.hpp"

namespace clba {
namespace {

const char* termination_name(int32_t termination) {
    switch (termination) {
        case CLBA_CONVERGENCE:
            return "convergence";
        case CLBA_NO_CONVERGENCE:
            return "no_convergence";
        case CLBA_FAILURE:
            return "failure";
        case CLBA_USER_STOP:
            return "user_stop";
    }
    return "unknown";
}

const char* reason_name(int32_t reason) {
    switch (reason) {
        case CLBA_REASON_FUNCTION_TOLERANCE:
            return "function_tolerance";
        case CLBA_REASON_GRADIENT_TOLERANCE:
            return "gradient_tolerance";
        case CLBA_REASON_PARAMETER_TOLERANCE:
            return "parameter_tolerance";
        case CLBA_REASON_TARGET_COST:
            return "target_cost";
        case CLBA_REASON_MAX_ITERATIONS:
            return "max_iterations";
        case CLBA_REASON_MAX_SECONDS:
            return "max_seconds";
        case CLBA_REASON_MIN_RADIUS:
            return "min_radius";
        case CLBA_REASON_INVALID_STEPS:
            return "invalid_steps";
        case CLBA_REASON_INVALID_START:
            return "invalid_start";
        case CLBA_REASON_CALLBACK:
            return "callback";
        case CLBA_REASON_NOTHING_TO_DO:
            return "nothing_to_do";
        case CLBA_REASON_CANCELLED:
            return "cancelled";
    }
    return "unknown";
}

const char* preconditioner_name(const clba_summary& summary) {
    if (summary.preconditioner == CLBA_PRECONDITIONER_DEFAULT) return "none";
    return clba_preconditioner_name(summary.preconditioner);
}

struct NamedSeconds {
    const char* field;  // of clba_summary, and of the JSON
    const char* label;
    double seconds;
};

std::vector<NamedSeconds> wall_times(const clba_summary& s) {
    return {{"build_seconds", "kernel build or load", s.build_seconds},
            {"setup_seconds", "setup and upload", s.setup_seconds},
            {"linearize_seconds", "linearization", s.linearize_seconds},
            {"linear_solver_seconds", "linear solver", s.linear_solver_seconds},
            {"evaluate_seconds", "trial states", s.evaluate_seconds},
            {"reference_seconds", "reference cost", s.reference_seconds},
            {"other_seconds", "other", s.other_seconds}};
}

std::vector<NamedSeconds> device_times(const clba_summary& s) {
    return {{"residual_device_seconds", "f      residuals", s.residual_device_seconds},
            {"jacobian_device_seconds", "J      Jacobian, gradient", s.jacobian_device_seconds},
            {"preconditioner_device_seconds", "M^-1   blocks, inverses",
             s.preconditioner_device_seconds},
            {"jx_device_seconds", "Jx     product", s.jx_device_seconds},
            {"jty_device_seconds", "Jty    product", s.jty_device_seconds},
            {"schur_device_seconds", "Sx     fused product", s.schur_device_seconds},
            {"vector_device_seconds", "vectors, dots, updates", s.vector_device_seconds}};
}

#if defined(__GNUC__)
__attribute__((format(printf, 2, 3)))
#endif
void append(std::string& text, const char* format, ...) {
    char line[512];  // longer than any label and the longest string of clba_summary together
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(line, sizeof line, format, arguments);
    va_end(arguments);
    text += line;
}

void append_times(std::string& text, const std::vector<NamedSeconds>& times, double total) {
    for (const NamedSeconds& time : times)
        append(text, "  %-26s %12.4f %6.1f %%\n", time.label, time.seconds,
               total > 0 ? 100 * time.seconds / total : 0.0);
    append(text, "  %-26s %12.4f\n", "total", total);
}

}  // namespace

std::string report_text(const clba_summary& s, const std::vector<clba_iteration>& rows) {
    std::string text;
    append(text, "Solver summary (clba %d.%d.%d)\n\n", CLBA_VERSION_MAJOR, CLBA_VERSION_MINOR,
           CLBA_VERSION_PATCH);
    append(text, "Device                       %s\n", s.device);
    append(text, "                             %-18s %s\n", "Given", "Used");
    append(text, "Linear solver                %-18s %s\n",
           clba_linear_solver_name(s.given_linear_solver),
           clba_linear_solver_name(s.linear_solver));
    append(text, "Preconditioner               %-18s %s\n",
           clba_preconditioner_name(s.given_preconditioner), preconditioner_name(s));
    append(text, "Precision                    %-18s %s\n", clba_precision_name(s.given_precision),
           clba_precision_name(s.precision));
    if (s.choice[0]) append(text, "Chosen because               %s\n", s.choice);
    append(text, "Jacobian                     %s\n", clba_jacobian_name(s.jacobian));
    append(text, "Damping                      %s\n", clba_damping_name(s.damping));
    append(text, "Forcing term                 %g\n\n", s.eta);

    append(text, "Cost\n");
    append(text, "  initial                    %.9e\n", s.initial_cost);
    append(text, "  final                      %.9e\n", s.final_cost);
    append(text, "  final, by the reference    %.9e\n", s.reference_final_cost);
    append(text, "  change                     %.9e\n", s.initial_cost - s.final_cost);
    if (s.initial_prior_cost > 0 || s.final_prior_cost > 0) {
        append(text, "  of priors, initial         %.9e\n", s.initial_prior_cost);
        append(text, "  of priors, final           %.9e\n", s.final_prior_cost);
    }
    if (!rows.empty())
        append(text, "  final max norm of gradient %.3e\n", rows.back().gradient_max_norm);

    append(text, "\nGauge                        %s%s", clba_gauge_state_name(s.gauge),
           s.num_gauge_freedoms > 0 ? "" : "\n");
    if (s.num_gauge_freedoms > 0) append(text, " in %d of 7 directions\n", s.num_gauge_freedoms);
    append(text, "Iterations                   %d\n", s.num_iterations);
    append(text, "  accepted steps             %d\n", s.num_accepted_steps);
    append(text, "  rejected steps             %d\n", s.num_rejected_steps);
    append(text, "  invalid steps              %d\n", s.num_invalid_steps);
    append(text, "  of the linear solver       %d\n", s.num_linear_solver_iterations);
    append(text, "Points behind their camera   %lld observations at the start, %lld at the end\n",
           static_cast<long long>(s.num_behind_initial),
           static_cast<long long>(s.num_behind_final));
    append(text, "Points in the camera's plane %lld observations at the end\n",
           static_cast<long long>(s.num_singular));
    append(text, "Indefinite blocks            %lld\n",
           static_cast<long long>(s.num_indefinite_blocks));

    append(text, "\nWall time                         seconds    share\n");
    append_times(text, wall_times(s), s.total_seconds);

    double device_total = 0;
    for (const NamedSeconds& time : device_times(s)) device_total += time.seconds;
    if (device_total > 0) {
        append(text, "\nTime on the device                seconds    share\n");
        append_times(text, device_times(s), device_total);
        append(text, "\nShare of the wall time\n");
        const double total = s.total_seconds - s.build_seconds;
        const auto share = [&](const char* label, double seconds) {
            append(text, "  %-26s %10.1f %%\n", label, total > 0 ? 100 * seconds / total : 0.0);
        };
        share("kernels", device_total);
        share("factorization on the host", s.factorization_seconds);
        share("the rest of the host", s.host_seconds);
    }

    if (s.resumed_iteration > 0)
        append(text, "\nResumed after iteration      %d\n", s.resumed_iteration);
    if (s.num_checkpoints > 0 || s.checkpoint_error[0])
        append(text, "\nCheckpoints written          %d\n", s.num_checkpoints);
    if (s.checkpoint_error[0])
        append(text, "  one was not                %s\n", s.checkpoint_error);
    append(text, "\nPeak device memory           %.1f MiB\n",
           static_cast<double>(s.peak_device_bytes) / (1 << 20));
    append(text, "Termination                  %s, %s\n", termination_name(s.termination),
           reason_name(s.reason));
    append(text, "                             %s\n", s.message);
    return text;
}

std::string report_json(const clba_summary& s, const std::vector<clba_iteration>& rows) {
    JsonWriter json;
    json.begin_object();
    json.add("device", s.device);
    json.add("linear_solver", clba_linear_solver_name(s.linear_solver));
    json.add("preconditioner", preconditioner_name(s));
    json.add("damping", clba_damping_name(s.damping));
    json.add("precision", clba_precision_name(s.precision));
    json.add("given_linear_solver", clba_linear_solver_name(s.given_linear_solver));
    json.add("given_preconditioner", clba_preconditioner_name(s.given_preconditioner));
    json.add("given_precision", clba_precision_name(s.given_precision));
    json.add("choice", s.choice);
    json.add("jacobian", clba_jacobian_name(s.jacobian));
    json.add("eta", s.eta);
    json.add("termination", termination_name(s.termination));
    json.add("reason", reason_name(s.reason));
    json.add("message", s.message);
    json.add("initial_cost", s.initial_cost);
    json.add("final_cost", s.final_cost);
    json.add("reference_final_cost", s.reference_final_cost);
    json.add("initial_prior_cost", s.initial_prior_cost);
    json.add("final_prior_cost", s.final_prior_cost);
    json.add("gauge", clba_gauge_state_name(s.gauge));
    json.add("num_gauge_freedoms", s.num_gauge_freedoms);
    json.add("num_iterations", s.num_iterations);
    json.add("num_accepted_steps", s.num_accepted_steps);
    json.add("num_rejected_steps", s.num_rejected_steps);
    json.add("num_invalid_steps", s.num_invalid_steps);
    json.add("num_linear_solver_iterations", s.num_linear_solver_iterations);
    json.add("num_behind_initial", s.num_behind_initial);
    json.add("num_behind_final", s.num_behind_final);
    json.add("num_singular", s.num_singular);
    json.add("num_indefinite_blocks", s.num_indefinite_blocks);
    json.add("peak_device_bytes", s.peak_device_bytes);
    // What is left of the total once kernels are built: what a second solve would take.
    json.add("solve_seconds", s.total_seconds - s.build_seconds - s.reference_seconds);
    json.add("total_seconds", s.total_seconds);
    for (const NamedSeconds& time : wall_times(s)) json.add(time.field, time.seconds);
    for (const NamedSeconds& time : device_times(s)) json.add(time.field, time.seconds);
    json.add("factorization_seconds", s.factorization_seconds);
    json.add("host_seconds", s.host_seconds);
    json.add("resumed_iteration", s.resumed_iteration);
    json.add("num_checkpoints", s.num_checkpoints);
    json.add("checkpoint_error", s.checkpoint_error);
    json.begin_array("iterations");
    for (const clba_iteration& row : rows) {
        json.begin_object();
        json.add("iteration", row.iteration);
        json.add("accepted", row.step_is_accepted != 0);
        json.add("valid", row.step_is_valid != 0);
        json.add("cost", row.cost);
        json.add("cost_change", row.cost_change);
        json.add("gradient_max_norm", row.gradient_max_norm);
        json.add("step_norm", row.step_norm);
        json.add("gain_ratio", row.gain_ratio);
        json.add("trust_region_radius", row.trust_region_radius);
        json.add("linear_solver_iterations", row.linear_solver_iterations);
        json.add("num_behind", row.num_behind);
        json.add("seconds", row.seconds);
        json.add("remaining_iterations", row.remaining_iterations);
        json.add("remaining_seconds", row.remaining_seconds);
        json.end_object();
    }
    json.end_array();
    json.end_object();
    return json.take();
}

}  // namespace clba
