# SPDX-License-Identifier: Apache-2.0
"""One exception class for each error status of clba.h."""

from __future__ import annotations


class Error(Exception):
    """Base class of everything that the C library reports.

    Attributes:
        status: the value of ``clba_status``.
    """

    status: int = 0


class InvalidArgumentError(Error, ValueError):
    """A value breaks a rule; the message names the value and the rule."""

    status = -1


class OutOfMemoryError(Error, MemoryError):
    """The host or the device has too little memory."""

    status = -2


class NoDeviceError(Error, RuntimeError):
    """There is no OpenCL, no device of that name, or none with the precision asked for."""

    status = -3


class KernelBuildError(Error, RuntimeError):
    """A kernel does not compile; the message holds the compiler's log."""

    status = -4


class DeviceError(Error, RuntimeError):
    """Any other OpenCL error; close the problem and the context."""

    status = -5


class InternalError(Error, RuntimeError):
    """A bug in the library."""

    status = -6


class FileError(Error, OSError):
    """A file cannot be opened, read or written."""

    status = -7


class FormatError(Error, ValueError):
    """A file's content breaks a rule of its format."""

    status = -8


class NoPluginError(Error, RuntimeError):
    """``direct_schur`` needs the plug-in library clba_cholmod."""

    status = -9


class CancelledError(Error, RuntimeError):
    """A progress callback stopped a reading."""

    status = -10


BY_STATUS: dict[int, type[Error]] = {
    error.status: error
    for error in (
        InvalidArgumentError,
        OutOfMemoryError,
        NoDeviceError,
        KernelBuildError,
        DeviceError,
        InternalError,
        FileError,
        FormatError,
        NoPluginError,
        CancelledError,
    )
}
