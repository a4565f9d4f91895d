"""The one reading of a path that a person gives."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path

from ocp.errors import InputError


def expanded(path: str | PathLike[str]) -> Path:
    """The path, with a leading ``~`` or ``~name`` as the home directory that it stands for.

    Shells do this for a word of its own, not behind ``--out=``, in a variable or in Python.

    Raises :class:`~ocp.errors.InputError` where there is no such home.
    """
    given = Path(fspath(path))
    try:
        return given.expanduser()
    except RuntimeError:
        raise InputError(
            f"{given}: there is no user called {given.parts[0][1:]}; give the whole path, or"
            f" ./{given} for a file of that name"
        ) from None
