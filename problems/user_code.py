"""Calls of code in a user's file: an error is reported in one sentence, and changes to the process are undone."""

from __future__ import annotations

import functools
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from ocp.distribution import PACKAGES
from ocp.errors import InputError

Function = Callable[..., Any]


def guarded(
    function: Function,
    action: str,
    path: Path,
    check: Function | None = None,
    through: type[Exception] | tuple[()] = (),
) -> Function:
    """Return ``function`` of the file at ``path`` with every error converted to an InputError of one sentence.

    ``check`` converts the result or raises :class:`~ocp.errors.InputError`. Errors of the type
    ``through`` are raised unchanged.
    """

    @functools.wraps(function)
    def call(*positional: Any, **named: Any) -> Any:
        with user_code(f"{action} failed:", path, through):
            value = function(*positional, **named)
        try:
            return value if check is None else check(value)
        except InputError as error:
            raise InputError(f"{path}: {action} returned an invalid value: {error}") from error

    return call


@contextmanager
def user_code(action: str, path: Path, through: type[Exception] | tuple[()] = ()) -> Iterator[None]:
    """Run code of the file at ``path``, then undo its changes to the whole process.

    Raises :class:`~ocp.errors.InputError` with ``action``, the line and the reason for any exception
    raised inside, including ``SystemExit``. Only Ctrl-C and errors of the type ``through`` are
    raised unchanged.
    """
    try:
        with _restore_process():
            yield
    except through:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and _was_pressed(error, path):
            raise
        raise InputError(f"{path}: {action} {where(error, path)}") from error


@contextmanager
def _restore_process() -> Iterator[None]:
    """Restore working directory, ``sys.path``, streams, NumPy's error state and warning filters on exit."""
    folder, limit = _folder(), sys.getrecursionlimit()
    paths, streams = list(sys.path), (sys.stdout, sys.stderr)
    try:
        with np.errstate(), warnings.catch_warnings():
            yield
    finally:
        sys.stdout, sys.stderr = streams
        sys.path += [path for path in paths if path not in sys.path]
        sys.setrecursionlimit(max(limit, sys.getrecursionlimit()))
        if folder is not None and folder != _folder():
            with suppress(OSError):
                os.chdir(folder)


def _folder() -> str | None:
    try:
        return str(Path.cwd())
    except OSError:
        return None


def _was_pressed(error: BaseException, path: Path) -> bool:
    """Return whether a KeyboardInterrupt was due to Ctrl-C and not raised by the user's code."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        return True
    frames = traceback.extract_tb(error.__traceback__)
    return not frames or Path(frames[-1].filename) != path


def where(error: BaseException, path: Path) -> str:
    """Return the line of the user's file at which ``error`` was raised, its type, and its reason, as one text."""
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f"line {error.lineno}: {type(error).__name__}: {error.msg}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path]
    line = f"line {lines[-1]}: " if lines else ""
    name = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    shadowing_files = [path.parent / f"{name}.py", path.parent / name]
    twin = next((module for module in shadowing_files if name in PACKAGES and module.exists()), None)
    hint = "" if twin is None else f"; {twin} has the name of a package of centralpath; rename it"
    return f"{line}{type(error).__name__}: {reason(error)}{hint}"


def reason(error: BaseException) -> str:
    """Return the line of an error's message with the reason; in CasADi's messages it follows the location."""
    try:
        text = str(error)
    except Exception:
        return "no reason available"
    lines = [line.strip() for line in text.splitlines() if line.strip()] or ["no reason given"]
    return lines[-1] if lines[0].endswith(":") else lines[0]
