# SPDX-License-Identifier: Apache-2.0
"""What a solve did."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _ffi, _names
from clba._ffi import check, lib


@dataclass(frozen=True)
class Iteration:
    """One row of the iteration log. Iteration 0 describes the start.

    Attributes:
        step_is_accepted: the cost fell and the step was taken.
        step_is_valid: False if the linear solver failed or the cost was not finite.
        num_behind: observations of points behind their camera.
        cost: of the state kept, 1/2 sum rho(|r|^2), in squared pixels (or sigmas), and that of
            priors.
        cost_change: cost before the step minus cost after it; > 0 is a decrease.
        step_norm: Euclidean, over all free parameters.
        gain_ratio: cost_change divided by the decrease that the linearised model predicts.
        trust_region_radius: 1 / lambda, after this iteration's update.
        seconds: wall time since the solve was entered; after a resumption, also that of the solves
            before.
        remaining_iterations, remaining_seconds: an estimate from the trend of the cost, no more
            than the budgets leave; -1 while it is unknown.
    """

    iteration: int
    step_is_accepted: bool
    step_is_valid: bool
    linear_solver_iterations: int
    num_behind: int
    cost: float
    cost_change: float
    gradient_max_norm: float
    step_norm: float
    gain_ratio: float
    trust_region_radius: float
    seconds: float
    remaining_iterations: int
    remaining_seconds: float


# The fields of Iteration, as columns.
ITERATION_DTYPE = np.dtype(
    [
        ("iteration", np.int32),
        ("step_is_accepted", np.bool_),
        ("step_is_valid", np.bool_),
        ("linear_solver_iterations", np.int32),
        ("num_behind", np.int64),
        ("cost", np.float64),
        ("cost_change", np.float64),
        ("gradient_max_norm", np.float64),
        ("step_norm", np.float64),
        ("gain_ratio", np.float64),
        ("trust_region_radius", np.float64),
        ("seconds", np.float64),
        ("remaining_iterations", np.int32),
        ("remaining_seconds", np.float64),
    ]
)


def iteration(row: _ffi.Iteration) -> Iteration:
    """The row that a callback gets."""
    values = _ffi.fields(row)
    values["step_is_accepted"] = bool(values["step_is_accepted"])
    values["step_is_valid"] = bool(values["step_is_valid"])
    return Iteration(**values)


@dataclass(frozen=True, repr=False)
class Summary:
    """What a solve did. ``report()`` is it for people.

    Attributes:
        termination: "convergence", "no_convergence" (a limit on iterations or time was met),
            "failure" (no usable step could be found) or "user_stop". The problem holds the best
            state found, however the solve ended.
        reason: why it ended, as "function_tolerance" or "max_iterations".
        message: why it ended, for people.
        linear_solver, preconditioner, precision, jacobian: those used last.
        given_linear_solver, given_preconditioner, given_precision: those asked for.
        choice: why linear solver "auto" chose as it did, for people.
        num_iterations: rows of ``iterations``, less the start.
        num_singular: observations in the camera's own plane at the end: these keep a constant
            residual and no derivative.
        initial_cost, final_cost: 1/2 sum rho(|r|^2), in squared pixels (or sigmas), and what priors
            add: initial_prior_cost, final_prior_cost.
        gauge: "free", "fixed_by_constants" or "fixed_by_priors": what holds the world's rotation,
            translation and scale, of whose 7 freedoms num_gauge_freedoms are left.
        reference_final_cost: the same state, by the serial fp64 reference on the host.
        total_seconds: wall time; build (compiling or loading kernels), setup, linearize,
            linear_solver, evaluate, reference and other add up to it.
        residual_device_seconds and the other device times: time in kernels by step; 0 where the
            device cannot tell.
        resumed_iteration: of the checkpoint that the solve went on from; 0: of none.
        num_checkpoints: that were written.
        checkpoint_error: why the last one that failed could not be written; "" if none did.
        iterations: the log, an array of records with the fields of `Iteration`:
            ``summary.iterations["cost"]``, ``pandas.DataFrame(summary.iterations)``.
    """

    termination: str
    reason: str
    message: str
    device: str
    linear_solver: str
    preconditioner: str
    damping: str
    precision: str
    jacobian: str
    given_linear_solver: str
    given_preconditioner: str
    given_precision: str
    choice: str
    num_iterations: int
    num_accepted_steps: int
    num_rejected_steps: int
    num_invalid_steps: int
    num_linear_solver_iterations: int
    num_behind_initial: int
    num_behind_final: int
    num_singular: int
    num_indefinite_blocks: int
    eta: float
    initial_cost: float
    final_cost: float
    reference_final_cost: float
    initial_prior_cost: float
    final_prior_cost: float
    gauge: str
    num_gauge_freedoms: int
    total_seconds: float
    build_seconds: float
    setup_seconds: float
    linearize_seconds: float
    linear_solver_seconds: float
    evaluate_seconds: float
    reference_seconds: float
    other_seconds: float
    factorization_seconds: float
    host_seconds: float
    residual_device_seconds: float
    jacobian_device_seconds: float
    preconditioner_device_seconds: float
    jx_device_seconds: float
    jty_device_seconds: float
    schur_device_seconds: float
    vector_device_seconds: float
    peak_device_bytes: int
    resumed_iteration: int
    num_checkpoints: int
    checkpoint_error: str
    iterations: npt.NDArray[np.void] = field(compare=False)
    _report: str = field(compare=False)
    _json: str = field(compare=False)

    @property
    def converged(self) -> bool:
        """A tolerance was met."""
        return self.termination == "convergence"

    def report(self) -> str:
        """The whole summary as text of several lines, in the manner of Ceres' FullReport."""
        return self._report

    def json(self) -> str:
        """The summary and its iterations as JSON; numbers that are not finite are null."""
        return self._json

    def __repr__(self) -> str:
        return (
            f"<clba.Summary: {self.termination} ({self.reason}), cost {self.initial_cost:.6e} -> "
            f"{self.final_cost:.6e} in {self.num_iterations} iterations and "
            f"{self.total_seconds:.3g} s, {self.linear_solver} in {self.precision} on "
            f"{self.device}>"
        )


def summary(result: Any) -> Summary:
    """Everything that a clba_result holds."""
    struct = _ffi.sized(_ffi.Summary)
    check(lib.clba_result_get_summary(result, ctypes.byref(struct)))
    values = _ffi.fields(struct)
    for name, names in (
        ("termination", _names.TERMINATIONS),
        ("reason", _names.REASONS),
        ("linear_solver", _names.LINEAR_SOLVERS),
        ("damping", _names.DAMPINGS),
        ("precision", _names.PRECISIONS),
        ("jacobian", _names.JACOBIANS),
        ("given_linear_solver", _names.LINEAR_SOLVERS),
        ("given_preconditioner", _names.PRECONDITIONERS),
        ("given_precision", _names.PRECISIONS),
        ("gauge", _names.GAUGES),
    ):
        values[name] = _names.name_of(names, values[name])
    # 0 is the default when asked for, and none when used.
    used = values["preconditioner"]
    values["preconditioner"] = _names.name_of(_names.PRECONDITIONERS, used) if used != 0 else "none"
    return Summary(
        **values,
        iterations=_iterations(result),
        _report=_ffi.text(lib.clba_result_report(result)),
        _json=_ffi.text(lib.clba_result_json(result)),
    )


def _iterations(result: Any) -> npt.NDArray[np.void]:
    rows: npt.NDArray[np.void] = np.empty(lib.clba_result_num_rows(result), ITERATION_DTYPE)
    row = _ffi.sized(_ffi.Iteration)
    for index in range(len(rows)):
        check(lib.clba_result_get_row(result, index, ctypes.byref(row)))
        rows[index] = tuple(getattr(row, name) for name in ITERATION_DTYPE.names or ())
    return rows
