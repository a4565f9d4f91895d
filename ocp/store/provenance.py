"""Provenance of results: versions of libraries, digests of source files, and the git revision."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ocp.errors import InputError

_DISTRIBUTIONS = ("centralpath", "casadi", "numpy", "scipy", "xarray", "netCDF4")
"""Names of the distributions whose versions are stored with each run."""
_MAX_PATH_LENGTH = 4096
"""Length from which a text cannot be a path."""
_COMPUTING_PACKAGES = ("dynamics", "ocp", "problems")
"""Packages whose source code determines results."""


@cache
def versions() -> dict[str, str]:
    """Return a mapping from ``python`` and the names of libraries that determine results to their versions."""
    from importlib.metadata import PackageNotFoundError, version

    versions_by_name = {"python": platform.python_version()}
    for name in _DISTRIBUTIONS:
        try:
            versions_by_name[name] = version(name)
        except PackageNotFoundError:
            versions_by_name[name] = "not installed"
    return versions_by_name


def file_digest(file: Path) -> str:
    """Return the hexadecimal SHA-256 of a file; raise :class:`~ocp.errors.InputError` if it is unreadable."""
    try:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror or error}") from error


def content_digest(sources: Iterable[str | None], settings: Mapping[str, Any]) -> str:
    """Return the hexadecimal SHA-256 of the user's files on which a study depends, or "" if there are none.

    ``sources`` are the digests of the files of problem and law, None for a problem or law of the workbench.
    ``settings`` may contain paths of further files, such as ``model`` of a learned law. Raises the errors of
    :func:`file_digest`.
    """
    digests = [source for source in sources if source is not None]
    for key, value in sorted(settings.items()):
        file = Path(value) if isinstance(value, str | Path) else None
        # A longer text is not a path, and is_file would raise.
        if file is not None and len(str(file)) < _MAX_PATH_LENGTH and file.is_file():
            digests.append(f"{key} {file_digest(file)}")
    return hashlib.sha256("\n".join(digests).encode()).hexdigest() if digests else ""


class FilesChanged(InputError):
    """Error raised if a user's files have changed since a computation was requested."""


def check_content(
    problem: str, expected: str | None, sources: Iterable[str | None], settings: Mapping[str, Any]
) -> None:
    """Raise :class:`FilesChanged` if :func:`content_digest` differs from ``expected``, unless it is None."""
    if expected not in (None, content_digest(sources, settings)):
        raise FilesChanged(
            f"{problem}, what it imports, or a file of the law has changed since this was begun, so"
            " that two problems would mix; give the same command again"
        )


@cache
def program_digest() -> str:
    """Return the hexadecimal SHA-256 of the source of the computing packages, which users may edit."""
    digest = hashlib.sha256()
    for name in _COMPUTING_PACKAGES:
        spec = find_spec(name)
        for root in map(Path, (spec and spec.submodule_search_locations) or ()):
            for file in sorted(root.rglob("*.py")):
                digest.update(f"{name}/{file.relative_to(root)} {file_digest(file)}\n".encode())
    return digest.hexdigest()


@cache
def git_revision() -> str | None:
    """Return the git revision of this package's checkout, followed by ``+`` if the checkout has changes.

    Return None if the package is not at the root of a checkout or git fails.
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
