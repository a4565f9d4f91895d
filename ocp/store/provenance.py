"""Where a number came from: versions of what computed it, and the source's revision."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ocp.errors import InputError

_DISTRIBUTIONS = ("centralpath", "casadi", "numpy", "scipy", "xarray", "netCDF4")
_LONGEST = 4096
_COMPUTING = ("dynamics", "ocp", "problems")


@cache
def versions() -> dict[str, str]:
    """Versions of Python and of the distributions that shape an answer."""
    found = {"python": platform.python_version()}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def file_digest(file: Path) -> str:
    """SHA-256, in hex, of one file; raises :class:`~ocp.errors.InputError` where it is not read."""
    try:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror or error}") from error


def content_digest(sources: Iterable[str | None], settings: Mapping[str, Any]) -> str:
    """SHA-256, in hex, of a user's files that a study is asked of; "" of none.

    ``sources`` are the digests of the files of problem and law, None for those of the workbench;
    ``settings`` may name others, as ``model`` of a learned law does. Raises as :func:`file_digest`
    does.
    """
    found = [source for source in sources if source is not None]
    for key, value in sorted(settings.items()):
        file = Path(value) if isinstance(value, str | Path) else None
        # A long text is no place: to ask would raise.
        if file is not None and len(str(file)) < _LONGEST and file.is_file():
            found.append(f"{key} {file_digest(file)}")
    return hashlib.sha256("\n".join(found).encode()).hexdigest() if found else ""


class FilesChanged(InputError):
    """Files are no longer what a study was asked of; the message names them."""


def check_content(
    problem: str, expected: str | None, sources: Iterable[str | None], settings: Mapping[str, Any]
) -> None:
    """Raise :class:`FilesChanged` unless :func:`content_digest` is ``expected``, None for any."""
    if expected not in (None, content_digest(sources, settings)):
        raise FilesChanged(
            f"{problem}, what it imports, or a file of the law has changed since this was begun, so"
            " that two problems would mix; give the same command again"
        )


@cache
def program_digest() -> str:
    """SHA-256, in hex, of the source of all that computes: a version alone may be edited."""
    told = hashlib.sha256()
    for name in _COMPUTING:
        spec = find_spec(name)
        for root in map(Path, (spec and spec.submodule_search_locations) or ()):
            for file in sorted(root.rglob("*.py")):
                told.update(f"{name}/{file.relative_to(root)} {file_digest(file)}\n".encode())
    return told.hexdigest()


@cache
def git_revision() -> str | None:
    """Revision of the checkout that this package lies in, with ``+`` where it was changed.

    None where the package does not lie at the root of a checkout.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    commands = (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
    try:
        head, changes = (
            subprocess.run(
                ["git", "-C", str(root), *command],
                capture_output=True,
                text=True,
                timeout=10,
                check=True,
            ).stdout.strip()
            for command in commands
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return head + ("+" if changes else "")
