# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment on OpenCL devices.

import clba

problem = clba.Problem.read("problem.txt.bz2")
summary = clba.solve(problem)
print(summary.report())
"""

from clba import plot
from clba._cancellation import Cancellation
from clba._covariance import Covariance, StandardErrors
from clba._devices import Context, Device, devices
from clba._errors import (
    CancelledError,
    DeviceError,
    Error,
    FileError,
    FormatError,
    InternalError,
    InvalidArgumentError,
    KernelBuildError,
    NoDeviceError,
    NoPluginError,
    OutOfMemoryError,
)
from clba._evaluation import Evaluation
from clba._filter import FilterReport
from clba._names import PARAM_NAMES
from clba._problem import Comparison, Problem
from clba._solve import solve
from clba._summary import Iteration, Summary
from clba._version import __version__
from clba._window import Window

__all__ = [
    "PARAM_NAMES",
    "CancelledError",
    "Cancellation",
    "Comparison",
    "Context",
    "Covariance",
    "Device",
    "DeviceError",
    "Error",
    "Evaluation",
    "FileError",
    "FilterReport",
    "FormatError",
    "InternalError",
    "InvalidArgumentError",
    "Iteration",
    "KernelBuildError",
    "NoDeviceError",
    "NoPluginError",
    "OutOfMemoryError",
    "Problem",
    "StandardErrors",
    "Summary",
    "Window",
    "__version__",
    "devices",
    "plot",
    "solve",
]
