# SPDX-License-Identifier: Apache-2.0
"""``python -m clba``: devices and solves from the command line."""

from __future__ import annotations

import argparse
import pathlib
import sys
import warnings
from collections.abc import Sequence

import clba
from clba import _files, _names, plot

# Those of the clba command.
EXIT_OK, EXIT_NOT_SOLVED, EXIT_FILE, EXIT_NO_DEVICE, EXIT_DEVICE = 0, 3, 4, 5, 6
EXIT_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit code."""
    parsed = _parser().parse_args(arguments)
    try:
        code: int = parsed.run(parsed)
    except (clba.FileError, clba.FormatError, OSError) as error:
        return _fail(error, EXIT_FILE)
    except (clba.NoDeviceError, clba.NoPluginError) as error:
        return _fail(error, EXIT_NO_DEVICE)
    except (clba.InvalidArgumentError, ImportError) as error:
        return _fail(error, 2)
    except clba.Error as error:
        return _fail(error, EXIT_DEVICE)
    return code


def _fail(error: Exception, code: int) -> int:
    print(f"clba: error: {error}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m clba", description=clba.__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--version", action="version", version=clba.__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    devices = commands.add_parser("devices", help="list the OpenCL devices")
    devices.set_defaults(run=_devices)
    _add_solve(commands.add_parser("solve", help="refine a problem"))
    return parser


def _devices(_parsed: argparse.Namespace) -> int:
    found = clba.devices()
    for device in found:
        precision = "fp64" if device.has_double else "fp32"
        print(f"{device.index}  {device.type}  {precision}  {device.name}  ({device.platform})")
    if not found:
        print("no OpenCL device", file=sys.stderr)
    return EXIT_OK if found else EXIT_NO_DEVICE


def _add_solve(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=_solve)
    parser.add_argument("file", metavar="FILE", help="problem: a file or folder of any format")
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="the solution, in the format of the input"
    )
    parser.add_argument("--output-format", choices=_names.FORMATS, default="auto")
    parser.add_argument("--accept-loss", action="store_true", help="leave out what does not fit")
    parser.add_argument("--ply", metavar="FILE", help="points and camera centres")
    parser.add_argument("--json", metavar="FILE", help="the summary and every iteration")
    parser.add_argument("--report", metavar="FILE", help="a page of HTML with plots")
    parser.add_argument("--device", help="index, or part of the platform's or device's name")
    parser.add_argument("--linear-solver", choices=_names.LINEAR_SOLVERS, default="auto")
    parser.add_argument("--preconditioner", choices=_names.PRECONDITIONERS, default="default")
    parser.add_argument("--precision", choices=_names.PRECISIONS, default="auto")
    parser.add_argument("--damping", choices=_names.DAMPINGS, default="marquardt")
    parser.add_argument("--loss", choices=_names.LOSSES, default="none")
    parser.add_argument("--loss-scale", type=float, default=1.0, help="pixels")
    parser.add_argument("--max-iterations", type=int, help="limit; 50")
    parser.add_argument("--time-limit", type=float, help="seconds")
    parser.add_argument("--target-cost", type=float, help="end at a cost not above this; 0")
    parser.add_argument("--function-tolerance", type=float, help="1e-6")
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def _solve(parsed: argparse.Namespace) -> int:
    for name in (parsed.output, parsed.ply, parsed.json, parsed.report):
        if name is not None and not pathlib.Path(name).absolute().parent.is_dir():
            raise clba.FileError(f"{name}: its folder does not exist; make it first")
    if parsed.report is not None:
        plot._drawn_by("plotly")
    problem = _read(parsed)
    if problem.num_observations == 0:
        raise clba.FormatError(f"{parsed.file}: has no observations; nothing to solve")
    if parsed.output is not None:
        problem.check_write(
            parsed.output, format=parsed.output_format, accept_loss=parsed.accept_loss
        )
    problem.set_loss(parsed.loss, parsed.loss_scale)
    before = _state(problem, parsed)
    code = EXIT_OK
    try:
        clba.solve(
            problem,
            device=parsed.device,
            linear_solver=parsed.linear_solver,
            preconditioner=parsed.preconditioner,
            precision=parsed.precision,
            damping=parsed.damping,
            max_num_iterations=parsed.max_iterations,
            max_seconds=parsed.time_limit,
            target_cost=parsed.target_cost,
            function_tolerance=parsed.function_tolerance,
            progress=not parsed.quiet,
        )
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    summary = problem.summary
    if summary is None:
        return code  # interrupted before the solve began
    _write(problem, summary, before, parsed)
    if summary.termination == "failure":
        print(f"clba: error: {parsed.file}: not solved: {summary.message}", file=sys.stderr)
        code = EXIT_NOT_SOLVED
    return code


def _read(parsed: argparse.Namespace) -> clba.Problem:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they are printed as notes instead
        problem = clba.Problem.read(parsed.file)
    for notice in [] if parsed.quiet else problem.notices:
        print(f"clba: note: {parsed.file}: {notice}", file=sys.stderr)
    return problem


def _state(problem: clba.Problem, parsed: argparse.Namespace) -> plot.State | None:
    """For the report, if one is asked for."""
    if parsed.report is None:
        return None
    return plot.State.of(problem, device=parsed.device)


def _write(
    problem: clba.Problem,
    summary: clba.Summary,
    before: plot.State | None,
    parsed: argparse.Namespace,
) -> None:
    if parsed.output is not None:
        problem.write(parsed.output, format=parsed.output_format, accept_loss=parsed.accept_loss)
    if parsed.ply is not None:
        problem.to_ply(parsed.ply)
    if parsed.json is not None:
        _files.write(parsed.json, f"{summary.json()}\n".encode())
    after = _state(problem, parsed)
    if after is not None:
        title = pathlib.Path(parsed.file).name
        plot.report(parsed.report, summary, after, before, title=title)
    if not parsed.quiet:
        print(summary.report())


if __name__ == "__main__":
    sys.exit(main())
