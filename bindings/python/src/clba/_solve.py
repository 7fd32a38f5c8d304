# SPDX-License-Identifier: Apache-2.0
"""Solving a problem."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from ctypes import byref
from typing import Any

from clba import _ffi, _names, _summary, _window
from clba._cancellation import Cancellation
from clba._devices import Context, context_of
from clba._ffi import check, lib
from clba._interrupt import DeferredInterrupt
from clba._problem import Problem
from clba._rows import problem_info
from clba._summary import Iteration, Summary
from clba._window import Window

Callback = Callable[[Iteration], "bool | None"]


def solve(
    problem: Problem,
    *,
    window: Window | None = None,
    device: int | str | Context | None = None,
    linear_solver: _names.LinearSolver = "auto",
    preconditioner: _names.Preconditioner = "default",
    damping: _names.Damping = "marquardt",
    precision: _names.Precision = "auto",
    jacobian: _names.JacobianForm = "default",
    max_num_iterations: int | None = None,
    max_linear_solver_iterations: int | None = None,
    min_linear_solver_iterations: int | None = None,
    max_num_consecutive_invalid_steps: int | None = None,
    initial_trust_region_radius: float | None = None,
    max_trust_region_radius: float | None = None,
    min_trust_region_radius: float | None = None,
    min_relative_decrease: float | None = None,
    min_damping_diagonal: float | None = None,
    max_damping_diagonal: float | None = None,
    function_tolerance: float | None = None,
    gradient_tolerance: float | None = None,
    parameter_tolerance: float | None = None,
    target_cost: float | None = None,
    max_seconds: float | None = None,
    eta: float | None = None,
    callback: Callback | None = None,
    progress: bool = False,
    cancellation: Cancellation | None = None,
    checkpoint_path: str | os.PathLike[str] | None = None,
    checkpoint_every: int | None = None,
    resume_path: str | os.PathLike[str] | None = None,
) -> Summary:
    """Minimises a problem's cost from its state, and leaves it at the best state found.

    Blocks, with the GIL released. Ctrl-C stops within the step: the problem then holds the best
    state, ``problem.summary`` the summary, and KeyboardInterrupt is raised.

    Args:
        problem: changed in place.
        window: refines this part alone, at a cost that depends on it and not on the problem: its
            images, the points they see and the cameras that no other image uses are free, and
            what else takes part in their observations is constant. The summary is of this part.
        device: an index, a part of a platform's or device's name, or a ``clba.Context``; by default
            the environment variable CLBA_DEVICE, else the best device.
        linear_solver: "auto", "pcg_schur" (implicit Schur complement), "explicit_schur" (formed,
            and factorized on the host), "pcg_hessian" or "direct_schur" (needs a plug-in).
        preconditioner: "default", "block_jacobi" or "schur_jacobi" (of pcg_schur alone).
        damping: "marquardt", "levenberg" or "uncertainty".
        precision: "auto", "mixed", "double" or "single".
        jacobian: "default", "recomputed" or "stored", what the device keeps of it.
        max_num_iterations: 50 by default.
        max_linear_solver_iterations, min_linear_solver_iterations: of each step; 500 and 0.
        max_num_consecutive_invalid_steps: 5.
        initial_trust_region_radius: 1 / lambda of the first step; 1e4.
        max_trust_region_radius, min_trust_region_radius: 1e16 and 1e-32.
        min_relative_decrease: a step is accepted if its gain ratio exceeds this; 1e-3.
        min_damping_diagonal, max_damping_diagonal: 1e-6 and 1e32.
        function_tolerance: stop if |cost change| <= this * cost; 1e-6.
        gradient_tolerance: stop if the gradient's largest entry <= this; 1e-10.
        parameter_tolerance: stop if |step| <= this * (|x| + this); 1e-8.
        target_cost: stop if the cost <= this; 0.
        max_seconds: time budget; infinite.
        eta: forcing term of the inexact step, below 1; by default it follows the preconditioner.
        callback: called with an `Iteration` after each iteration; one that returns True stops the
            solve, and one that raises stops it and has its exception raised by ``solve``. It must
            not use the problem.
        progress: show a bar (of tqdm, also in notebooks).
        cancellation: ends the solve when another thread asks it to.
        checkpoint_path: file from which the solve can go on later, to the same bits as if it had
            never ended; written also where a limit, the callback or a cancellation ends it.
        checkpoint_every: iterations between checkpoints; 10 by default, 0: none but the last.
        resume_path: goes on from this checkpoint instead of the problem's state. Measurements,
            weights, constants, loss, linear solver, preconditioner, damping, precision and
            jacobian must be as they were; limits and tolerances may differ.

    Raises:
        ValueError: an option breaks a rule, or the problem is closed.
        TypeError: an option has the wrong type.
        NoDeviceError: there is no such device, or it lacks the precision.
        FileError, FormatError: a checkpoint cannot be read or is damaged, or the path for one
            cannot be written. The problem is as it was.
        RuntimeError: the problem is being solved by another thread.
    """
    if not isinstance(problem, Problem):
        raise TypeError(f"problem is a {type(problem).__name__}, but it must be a clba.Problem")
    if callback is not None and not callable(callback):
        raise TypeError(f"callback = {callback!r}, but it must be a function of an Iteration")
    options = _ffi.SolverOptions()
    check(lib.clba_solver_options_init(byref(options), ctypes.sizeof(options)))
    options.linear_solver = _names.value_of(_names.LINEAR_SOLVERS, linear_solver, "linear_solver")
    options.preconditioner = _names.value_of(
        _names.PRECONDITIONERS, preconditioner, "preconditioner"
    )
    options.damping = _names.value_of(_names.DAMPINGS, damping, "damping")
    options.precision = _names.value_of(_names.PRECISIONS, precision, "precision")
    options.jacobian = _names.value_of(_names.JACOBIANS, jacobian, "jacobian")
    numbers = {
        "max_num_iterations": max_num_iterations,
        "max_linear_solver_iterations": max_linear_solver_iterations,
        "min_linear_solver_iterations": min_linear_solver_iterations,
        "max_num_consecutive_invalid_steps": max_num_consecutive_invalid_steps,
        "initial_trust_region_radius": initial_trust_region_radius,
        "max_trust_region_radius": max_trust_region_radius,
        "min_trust_region_radius": min_trust_region_radius,
        "min_relative_decrease": min_relative_decrease,
        "min_damping_diagonal": min_damping_diagonal,
        "max_damping_diagonal": max_damping_diagonal,
        "function_tolerance": function_tolerance,
        "gradient_tolerance": gradient_tolerance,
        "parameter_tolerance": parameter_tolerance,
        "target_cost": target_cost,
        "max_seconds": max_seconds,
        "eta": eta,
        "checkpoint_every": checkpoint_every,
    }
    for name, value in numbers.items():
        _ffi.set_number(options, name, value)
    if checkpoint_path is not None:
        options.checkpoint_path = os.fsencode(checkpoint_path)
    if resume_path is not None:
        options.resume_path = os.fsencode(resume_path)
    if cancellation is None:
        cancellation = Cancellation()
    elif not isinstance(cancellation, Cancellation):
        raise TypeError(f"cancellation = {cancellation!r}, but it must be a clba.Cancellation")
    if window is not None and not isinstance(window, Window):
        raise TypeError(f"window = {window!r}, but it must be a clba.Window")
    context = context_of(device)
    if not progress:
        return _run(problem, window, context, options, callback, cancellation)
    from clba._progress import Progress

    with Progress(options.max_num_iterations) as bar:
        return _run(problem, window, context, options, bar.before(callback), cancellation)


def _run(
    problem: Problem,
    window: Window | None,
    context: Context,
    options: _ffi.SolverOptions,
    callback: Callback | None,
    cancellation: Cancellation,
) -> Summary:
    raised: list[BaseException] = []

    # There is a callback even if the caller has none: it is where Ctrl-C is noticed.
    def on_iteration(row: Any, _user_data: object) -> int:
        try:
            should_stop = callback is not None and callback(_summary.iteration(row.contents))
            return int(bool(should_stop) or interrupt.is_pending)
        except BaseException as error:
            raised.append(error)
            return 1

    options.on_iteration = _ffi.IterationFunction(on_iteration)
    options.cancellation = cancellation._handle
    result = ctypes.POINTER(_ffi.ResultHandle)()
    with DeferredInterrupt(cancellation) as interrupt:
        with problem._solving() as handle, context._use() as context_handle:
            if window is None:
                status = lib.clba_problem_solve(
                    handle, context_handle, byref(options), byref(result)
                )
            else:
                rows = _window.Rows(window, problem_info(handle))
                status = lib.clba_problem_solve_window(
                    handle, context_handle, byref(options), byref(rows.struct), byref(result)
                )
            check(status)
        try:
            summary = _summary.summary(result)
        finally:
            lib.clba_result_release(result)
        problem._summary = summary
        if raised:
            raise raised[0]
    return summary
