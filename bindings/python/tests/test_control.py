# SPDX-License-Identifier: Apache-2.0
"""Cancellation and checkpoints."""

from __future__ import annotations

import pathlib
import signal
import threading

import numpy as np
import pytest

import clba


def hall() -> clba.Problem:
    return clba.Problem.generate("hall", num_images=8, observations_per_image=60, seed=1)[0]


def test_a_cancellation_holds_until_it_is_reset() -> None:
    problem, cancellation = hall(), clba.Cancellation()
    cancellation.request()
    assert cancellation.is_requested
    summary = clba.solve(problem, cancellation=cancellation)
    assert (summary.termination, summary.reason) == ("user_stop", "cancelled")
    assert summary.num_iterations == 0
    cancellation.reset()
    assert clba.solve(problem, cancellation=cancellation).converged
    with pytest.raises(TypeError, match="cancellation"):
        clba.solve(problem, cancellation=True)  # type: ignore[arg-type]


def test_interrupt_reaches_the_library_between_callbacks() -> None:
    """The handler of Python does not run before the solve has ended, and yet it is cancelled."""
    problem = hall()
    main = threading.main_thread().ident
    assert main is not None

    def interrupt(iteration: clba.Iteration) -> None:
        if iteration.iteration == 0:
            threading.Timer(0.02, signal.pthread_kill, (main, signal.SIGINT)).start()

    wakeup = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(wakeup)
    with pytest.raises(KeyboardInterrupt):
        clba.solve(
            problem,
            callback=interrupt,
            linear_solver="pcg_hessian",
            eta=1e-300,
            max_linear_solver_iterations=10**9,
            max_num_iterations=10**6,
            function_tolerance=0,
            gradient_tolerance=0,
            parameter_tolerance=0,
            max_seconds=120,
        )
    assert signal.set_wakeup_fd(wakeup) == wakeup
    assert problem.summary is not None
    assert problem.summary.termination == "user_stop"


def test_a_checkpoint_goes_on_to_the_same_bits(tmp_path: pathlib.Path) -> None:
    whole, first, second = hall(), hall(), hall()
    clba.solve(whole)
    path = tmp_path / "solve.checkpoint"
    begun = clba.solve(first, max_num_iterations=2, checkpoint_path=path, checkpoint_every=0)
    assert (begun.num_checkpoints, begun.checkpoint_error) == (1, "")
    summary = clba.solve(second, resume_path=path)
    assert summary.resumed_iteration == 2
    np.testing.assert_array_equal(second.poses, whole.poses)
    np.testing.assert_array_equal(second.points, whole.points)
    remaining = summary.iterations["remaining_iterations"]
    assert remaining[0] == -1 and remaining[-1] >= 0
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(clba.FormatError, match="damaged"):
        clba.solve(second, resume_path=path)
    with pytest.raises(clba.FileError):
        clba.solve(second, resume_path=tmp_path / "absent")
