# SPDX-License-Identifier: Apache-2.0
"""Solves: summaries, options, callbacks, interrupts, threads."""

from __future__ import annotations

import json
import signal
import threading
import time
from dataclasses import fields

import numpy as np
import pandas as pd
import pytest

import clba


def test_summary(hall: clba.Problem) -> None:
    start = hall.evaluate(jacobian=False).cost
    summary = clba.solve(hall, linear_solver="pcg_schur", precision="double")
    assert hall.summary is summary
    assert summary.converged and summary.termination == "convergence"
    assert summary.reason.endswith("_tolerance")
    assert summary.initial_cost == pytest.approx(start, rel=1e-12)
    assert summary.final_cost == pytest.approx(hall.evaluate(jacobian=False).cost, rel=1e-9)
    assert summary.reference_final_cost == pytest.approx(summary.final_cost, rel=1e-9)
    assert (summary.linear_solver, summary.preconditioner) == ("pcg_schur", "schur_jacobi")
    assert (summary.given_preconditioner, summary.precision) == ("default", "double")
    assert summary.total_seconds > 0 and summary.peak_device_bytes > 0
    report = summary.report()
    assert report.startswith("Solver summary (clba ") and "Termination" in report
    assert repr(summary).startswith("<clba.Summary: convergence (")
    assert clba.solve(hall, linear_solver="explicit_schur").preconditioner == "none"


def test_iterations_are_those_of_the_json(hall: clba.Problem) -> None:
    summary = clba.solve(hall)
    log = json.loads(summary.json())
    assert log["final_cost"] == summary.final_cost
    assert len(summary.iterations) == summary.num_iterations + 1 == len(log["iterations"])
    frame = pd.DataFrame(summary.iterations)
    assert list(frame.columns) == [field.name for field in fields(clba.Iteration)]
    assert frame["cost"].tolist() == [row["cost"] for row in log["iterations"]]
    assert frame["step_is_accepted"].tolist() == [row["accepted"] for row in log["iterations"]]
    assert frame["step_is_valid"].dtype == bool
    assert frame["iteration"].tolist() == list(range(len(frame)))


def test_summary_has_every_field_of_the_json(hall: clba.Problem) -> None:
    summary = clba.solve(hall)
    for name, value in json.loads(summary.json()).items():
        if name not in ("iterations", "solve_seconds"):
            assert getattr(summary, name) == value, name


def test_options_reach_the_solver(hall: clba.Problem) -> None:
    summary = clba.solve(
        hall,
        linear_solver="pcg_schur",
        preconditioner="block_jacobi",
        damping="levenberg",
        precision="mixed",
        jacobian="stored",
        max_num_iterations=2,
        initial_trust_region_radius=10.0,
        function_tolerance=0,
        eta=0.5,
    )
    assert summary.preconditioner == "block_jacobi"
    assert (summary.damping, summary.jacobian, summary.eta) == ("levenberg", "stored", 0.5)
    assert (summary.num_iterations, summary.reason) == (2, "max_iterations")
    assert summary.termination == "no_convergence"
    assert clba.solve(hall, target_cost=1e30).reason == "target_cost"
    assert clba.solve(hall, max_num_iterations=np.int64(1)).num_iterations <= 1


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (
            {"linear_solver": "qr"},
            ValueError,
            "linear_solver = 'qr', but it must be one of pcg_schur, pcg_hessian, direct_schur, "
            "explicit_schur, auto",
        ),
        (
            {"precision": "half"},
            ValueError,
            "precision = 'half', but .* auto, double, mixed, single",
        ),
        ({"damping": 3}, TypeError, "damping = 3, but it must be a name: marquardt"),
        ({"max_num_iterations": 2.5}, TypeError, "max_num_iterations = 2.5, .* an integer"),
        ({"max_num_iterations": 2**40}, ValueError, "must fit into 32 bits"),
        ({"max_num_iterations": -1}, ValueError, "max_num_iterations = -1, but it must be >= 0"),
        ({"eta": "small"}, TypeError, "eta = 'small', but it must be a number"),
        ({"eta": 2}, ValueError, "eta = 2"),
        ({"max_seconds": 0}, ValueError, "max_seconds = 0, but it must be > 0"),
        ({"callback": 3}, TypeError, "callback = 3, but it must be a function"),
        ({"device": "no such device"}, clba.NoDeviceError, "'no such device' in its name"),
        ({"device": 99}, clba.NoDeviceError, "there is no device 99"),
        ({"device": 1.5}, TypeError, "device = 1.5"),
        (
            {"linear_solver": "pcg_hessian", "preconditioner": "schur_jacobi"},
            clba.InvalidArgumentError,
            "pcg_hessian works on the full Hessian",
        ),
        ({"iterations": 3}, TypeError, "unexpected keyword argument 'iterations'"),
    ],
)
def test_options_that_are_wrong(
    hall: clba.Problem, options: dict[str, object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        clba.solve(hall, **options)  # type: ignore[arg-type]


def test_callback_sees_the_log_and_can_stop(hall: clba.Problem) -> None:
    rows: list[clba.Iteration] = []

    def stop_at_two(iteration: clba.Iteration) -> bool:
        rows.append(iteration)
        return iteration.iteration == 2

    summary = clba.solve(hall, callback=stop_at_two, function_tolerance=0)
    assert (summary.termination, summary.reason) == ("user_stop", "callback")
    assert [row.iteration for row in rows] == [0, 1, 2]
    assert [row.cost for row in rows] == summary.iterations["cost"].tolist()
    assert hall.evaluate(jacobian=False).cost == pytest.approx(summary.final_cost, rel=1e-6)


def test_callback_that_raises(hall: clba.Problem) -> None:
    start = hall.evaluate(jacobian=False).cost

    def raise_at_one(iteration: clba.Iteration) -> None:
        if iteration.iteration == 1:
            raise LookupError("from the callback")

    with pytest.raises(LookupError, match="from the callback"):
        clba.solve(hall, callback=raise_at_one)
    assert hall.summary is not None and hall.summary.termination == "user_stop"
    assert hall.summary.num_iterations == 1
    assert hall.evaluate(jacobian=False).cost < start
    assert clba.solve(hall).converged


def test_callback_must_not_use_the_problem(hall: clba.Problem) -> None:
    def look(_iteration: clba.Iteration) -> None:
        _ = hall.points

    with pytest.raises(RuntimeError, match="the problem is being solved"):
        clba.solve(hall, callback=look)

    def close(_iteration: clba.Iteration) -> None:
        hall.close()

    with pytest.raises(RuntimeError, match="the problem is being solved"):
        clba.solve(hall, callback=close)
    assert hall.num_images == 6


def test_interrupt_stops_and_keeps_the_best_state(hall: clba.Problem) -> None:
    start = hall.evaluate(jacobian=False).cost

    def interrupt(iteration: clba.Iteration) -> None:
        if iteration.iteration == 1:
            signal.raise_signal(signal.SIGINT)

    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        clba.solve(hall, callback=interrupt, function_tolerance=0)
    assert signal.getsignal(signal.SIGINT) is handler
    assert hall.summary is not None
    assert (hall.summary.termination, hall.summary.num_iterations) == ("user_stop", 1)
    cost = hall.evaluate(jacobian=False).cost
    assert cost == pytest.approx(hall.summary.final_cost, rel=1e-6) and cost < start


def test_interrupt_without_a_callback() -> None:
    """The signal comes while the library works, from another thread."""
    problem, _ = clba.Problem.generate("hall", num_images=60)
    main = threading.main_thread().ident
    assert main is not None
    timer = threading.Timer(0.05, signal.pthread_kill, (main, signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        timer.start()
        clba.solve(
            problem,
            function_tolerance=0,
            gradient_tolerance=0,
            parameter_tolerance=0,
            max_num_iterations=10**6,
            max_seconds=120,
        )
    assert problem.summary is None or problem.summary.termination == "user_stop"
    assert problem.num_images == 60


def test_other_threads_run_while_solving() -> None:
    """The GIL is released: a thread counts between two callbacks."""
    problem, _ = clba.Problem.generate("hall", num_images=60)
    count, counts, is_done = 0, [], threading.Event()

    def run() -> None:
        nonlocal count
        while not is_done.is_set():
            count += 1
            time.sleep(0)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        clba.solve(problem, callback=lambda _iteration: counts.append(count))
    finally:
        is_done.set()
        thread.join()
    assert len(counts) > 2 and counts[-1] > counts[0]


def test_two_threads_on_one_problem(hall: clba.Problem) -> None:
    is_solving, may_end = threading.Event(), threading.Event()
    summaries: list[clba.Summary] = []

    def wait(_iteration: clba.Iteration) -> None:
        is_solving.set()
        may_end.wait()

    thread = threading.Thread(target=lambda: summaries.append(clba.solve(hall, callback=wait)))
    thread.start()
    is_solving.wait()
    try:
        for use in (lambda: clba.solve(hall), lambda: hall.points, hall.evaluate, hall.close):
            with pytest.raises(RuntimeError, match="the problem is being solved"):
                use()
        assert repr(hall) == "<clba.Problem, being solved>"
    finally:
        may_end.set()
        thread.join()
    assert summaries[0].converged
    assert hall.num_images == 6


def test_two_threads_on_two_problems() -> None:
    """They share a device and give what each gives alone, to the last bit."""

    def problem() -> clba.Problem:
        return clba.Problem.generate("hall", num_images=10, seed=1)[0]

    alone = clba.solve(problem()).final_cost
    costs = []
    threads = [
        threading.Thread(target=lambda: costs.append(clba.solve(problem()).final_cost))
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert costs == [alone] * 4


def test_threads_take_turns_with_getters(problem: clba.Problem) -> None:
    points = problem.points
    failures: list[Exception] = []

    def read() -> None:
        try:
            for _ in range(200):
                assert np.array_equal(problem.points, points)
                problem.points = points
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


def test_progress(hall: clba.Problem, capfd: pytest.CaptureFixture[str]) -> None:
    seen = []
    summary = clba.solve(hall, progress=True, callback=lambda row: seen.append(row.iteration))
    assert len(seen) == summary.num_iterations + 1
    shown = capfd.readouterr().err
    assert "clba" in shown and f"cost={summary.iterations['cost'][-1]:.6e}" in shown


def test_context(hall: clba.Problem, tmp_path: object) -> None:
    with clba.Context(cache_dir="") as context:
        assert context.device in clba.devices()
        assert context.device.name in repr(context)
        assert clba.solve(hall, device=context).device == context.device.name
    with pytest.raises(ValueError, match="the context is closed"):
        clba.solve(hall, device=context)
    assert repr(context) == "<clba.Context, closed>"
    assert hall.evaluate().cost > 0


def test_nothing_to_do() -> None:
    assert clba.solve(clba.Problem()).reason == "nothing_to_do"


def test_solve_of_something_else() -> None:
    with pytest.raises(TypeError, match=r"problem is a str, but it must be a clba\.Problem"):
        clba.solve("problem.txt")  # type: ignore[arg-type]
