"""The distribution: its version, and its packages, which modules in the user's folder may hide.

The packages' names are common words. ``python -m ocp`` puts the working directory first on the
path, so that a user's ``problems.py`` would hide the package; importing this module removes that
entry. For a script in the same folder as such a file, the error of the first failed import names the file.
"""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path

DISTRIBUTION_NAME = "centralpath"
"""Name of the distribution on the package index."""
_SOURCE_ROOT = Path(__file__).resolve().parents[1]
"""Folder that contains the four packages."""
PACKAGES = ("dynamics", "ocp", "problems", "reports")
"""Packages of the distribution, from the lowest layer to the highest."""


class ShadowedPackage(ImportError):
    """Error if a user's module hides a package of the distribution; the message names the module."""

    exit_code = 2


def version() -> str:
    """Return the installed version; "unknown" in a checkout that is not installed."""
    from importlib import metadata

    try:
        return metadata.version(DISTRIBUTION_NAME)
    except metadata.PackageNotFoundError:
        return "unknown"


def shadowing(names: tuple[str, ...] = PACKAGES, folder: Path | None = None) -> str:
    """Return a sentence on the user's module that hides a package of ``names``, "" if no package is hidden.

    If ``folder`` is given, modules are searched in the order of imports by a script in that folder.
    """
    for name in names:
        loaded = sys.modules.get(name)
        if folder is not None:
            spec = PathFinder.find_spec(name, [str(folder), *sys.path])
        else:
            spec = find_spec(name) if loaded is None else loaded.__spec__
        locations = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
        location = next((Path(location).resolve() for location in locations if location), None)
        if location is not None and not location.is_relative_to(_SOURCE_ROOT / name):
            return (
                f"{location} has the name of the package {name} of {DISTRIBUTION_NAME} and hides it;"
                " rename it, or start Python with -P"
            )
    return ""


def _started_as_module() -> bool:
    """Return whether ``python -m ocp``, which puts the working directory on the path, imported this module."""
    if sys.argv[:1] != ["-m"] or sys.flags.safe_path:
        return False
    return sys.orig_argv[len(sys.orig_argv) - len(sys.argv)].removeprefix("-m") == "ocp"


def _check_shadowing() -> None:
    if _started_as_module() and Path(sys.path[0]).resolve() != _SOURCE_ROOT:
        del sys.path[0]
    if shadowed := shadowing(("dynamics",)):
        raise ShadowedPackage(shadowed)


_check_shadowing()
