"""The distribution: its version, its packages, and those above this one, loaded by entry point.

Their names are common words. ``python -m ocp`` puts the working directory first on the path, where
a user's ``problems.py`` would stand for ours: importing this module takes that place off again. To
a script that has such a file beside it, the first import that fails says so. Packages above are
never imported by name, so that imports run one way only, and loaded where they are used.
"""

from __future__ import annotations

import sys
from importlib import metadata
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ocp.errors import InputError

NAME = "centralpath"
_ROOT = Path(__file__).resolve().parents[1]
_BESIDE = ("dynamics", "problems", "reports")


class ShadowedPackage(ImportError):
    """Something of the user's has the name of one of our packages; the message says what."""

    exit_code = 2


def version() -> str:
    """Version of what is installed; "unknown" where nothing is, as in a bare checkout."""
    try:
        return metadata.version(NAME)
    except metadata.PackageNotFoundError:
        return "unknown"


def shadowing(names: tuple[str, ...] = _BESIDE, folder: Path | None = None) -> str:
    """One sentence on what Python finds in the place of the first hidden package of ``names``.

    It is empty where all are ours. With a ``folder`` it is what a script in there would find.
    """
    for name in names:
        found = sys.modules.get(name)
        if folder is not None:
            spec = PathFinder.find_spec(name, [str(folder), *sys.path])
        else:
            spec = find_spec(name) if found is None else found.__spec__
        places = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
        place = next((Path(place).resolve() for place in places if place), None)
        if place is not None and not place.is_relative_to(_ROOT / name):
            return (
                f"{place} has the name of the package {name} of {NAME} and hides it; rename it, or start Python with -P"
            )
    return ""


def _started_as_module() -> bool:
    """Whether this import is that of ``python -m ocp``, with the working directory on the path."""
    if sys.argv[:1] != ["-m"] or sys.flags.safe_path:
        return False
    return sys.orig_argv[len(sys.orig_argv) - len(sys.argv)].removeprefix("-m") == "ocp"


def _check_shadowing() -> None:
    if _started_as_module() and Path(sys.path[0]).resolve() != _ROOT:
        del sys.path[0]
    if told := shadowing(("dynamics",)):
        raise ShadowedPackage(told)


_check_shadowing()


GROUP = "centralpath.plugins"


def load_plugin(name: str) -> Any:
    """Load the module that the entry point ``name``, "problems" or "reports", refers to.

    Raises :class:`~ocp.errors.InputError` where the distribution is not installed, and
    :class:`~ocp.distribution.ShadowedPackage` where a user's module of that name is found instead.
    """
    found = [*entry_points(group=GROUP, name=name)]
    if not found:
        raise InputError(
            f"the package {name} of centralpath is not installed; install the distribution, as in"
            " pip install centralpath"
        )
    try:
        return found[0].load()
    except ImportError as error:
        if hidden := shadowing((name,)):
            raise ShadowedPackage(hidden) from error
        raise
