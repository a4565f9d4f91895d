"""Messages and exit codes of failed commands."""

from __future__ import annotations

import errno
import os
import re
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from reports.cli import streams

_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Error numbers of a disk without space, or of a failed write."""


def explain(error: BaseException) -> tuple[str, int]:
    """Return the message and the exit code of an exception."""
    # Exceptions are recognised by attributes, since typer has its own copy of click, and importing
    # ocp.errors would load CasADi for every ocp --help.
    if hasattr(error, "format_message"):
        message = error.format_message()  # pyright: ignore[reportAttributeAccessIssue]
        if not message or type(error).__name__ == "NoArgsIsHelpError":
            return "", 2
        return f"{_shortened(_usage(error, message)).rstrip('.')}; see ocp --help", 2
    if isinstance(code := getattr(error, "exit_code", None), int):
        return _shortened(str(error)), code
    # rich converts a broken pipe to SystemExit.
    if isinstance(error.__context__ if isinstance(error, SystemExit) else error, BrokenPipeError):
        streams.discard_buffers()
        return "", 1
    if isinstance(error, SystemExit) and "_OCP_COMPLETE" in os.environ:
        return "", error.code if isinstance(error.code, int) else 1
    if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
        streams.discard_buffers()
        destination = f" to {_shortened(str(error.filename))}" if error.filename is not None else ""
        return f"cannot write{destination}: {error.strerror}; free some space or write elsewhere", 1
    if isinstance(error, ImportError) and (hidden := hidden_package()):
        return hidden, 2
    if isinstance(error, OSError) and error.filename is not None:
        reason = f"{error.strerror}; name another file or directory"
        return f"cannot use {_shortened(str(error.filename))}: {reason}", 2
    if isinstance(error, FileNotFoundError):
        try:
            Path.cwd()
        except FileNotFoundError:
            return "the working directory no longer exists; change to another one", 2
    if isinstance(error, MemoryError):
        return "not enough memory; use fewer steps, scenarios or samples", 2
    return (
        f"internal error, {type(error).__name__}: {_shortened(str(error))}\n"
        "this is a bug in the workbench; --debug shows its location",
        1,
    )


def hidden_package() -> str:
    """Return a sentence on the file or folder that hides one of our packages; "" if none does."""
    try:
        from ocp.distribution import shadowing
    except ImportError as error:
        return str(error)
    return shadowing()


def _usage(error: Any, message: str) -> str:
    """Return the parser's message, with a suggestion in the form of our own messages: (did you mean X?)."""
    option_names = getattr(error, "possibilities", None)
    if not option_names:
        return re.sub(r"\. Did you mean ('[^']+').*", r" (did you mean \1?)", message)
    nearest = get_close_matches(error.option_name, option_names, n=1, cutoff=0.0)[0]
    return f"No such option {error.option_name!r} (did you mean {nearest!r}?)"


def _shortened(message: str) -> str:
    """Return a message with very long words shortened, and control characters and invalid text escaped.

    Quoted text therefore cannot control the terminal.
    """
    message = message.encode("utf-8", "backslashreplace").decode()
    message = re.sub(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", lambda sign: repr(sign[0])[1:-1], message)
    return re.sub(r"\S{200,}", lambda word: f"{word[0][:60]}...{word[0][-30:]}", message)
