"""Where a number came from: versions of what computed it, and the source's revision."""

from __future__ import annotations

import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_DISTRIBUTIONS = ("centralpath", "casadi", "numpy", "scipy", "xarray", "netCDF4")


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
                capture_output=True, text=True, timeout=10, check=True,
            ).stdout.strip()
            for command in commands
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return head + ("+" if changes else "")
