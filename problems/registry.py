"""Every problem by name, and a user's own file as if it had one."""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from ocp.errors import InputError, did_you_mean
from ocp.problem import Problem
from ocp.validation import expand_path
from problems.loading import check, check_file, import_file, read
from problems.source_digest import source_digest
from problems.spec import ProblemSpec, defined

_MODULES = {
    "wall-1d": "problems.wall_1d",
    "push-1d": "problems.push_1d",
    "push-disc": "problems.push_disc",
    "ball-bounce": "problems.ball_bounce",
    "cart-walls": "problems.cart_walls",
    "box-slide": "problems.box_slide",
    "ball-throw": "problems.ball_throw",
    "cart-transport": "problems.cart_transport",
    "hopper-1d": "problems.hopper_1d",
    "planar-push": "problems.planar_push",
    "planar-hand": "problems.planar_hand",
    "hopper": "problems.hopper",
    "half-cheetah": "problems.half_cheetah",
}
_TRIES = 3
"""To read a file that is being edited; one that writes to what it names is never at rest."""


def names() -> list[str]:
    """Names of the problems that ship with the workbench."""
    return list(_MODULES)


def spec(name: str) -> ProblemSpec:
    """Return the problem called ``name``, or the one that the file ``name`` (``*.py``) defines.

    Raises :class:`~ocp.errors.InputError` for a name that is neither.
    """
    return load(name) if name.endswith(".py") else registered(name)


def registered(name: str) -> ProblemSpec:
    """Return the problem called ``name`` that ships with the workbench; no file is ever loaded.

    Raises :class:`~ocp.errors.InputError` for a name that there is not.
    """
    if name not in _MODULES:
        raise InputError(
            f"unknown problem {name!r}{did_you_mean(name, _MODULES)}; there are"
            f" {', '.join(_MODULES)}, or give the path of a file such as my_problem.py"
        )
    return _module_of(name)


def get(name: str, **params: Any) -> Problem:
    """Build the problem ``name`` with ``params``, the rest at their defaults.

    Raises :class:`~ocp.errors.InputError` for an unknown name or a bad parameter.
    """
    return spec(name).problem(params)


def load(path: str | Path) -> ProblemSpec:
    """Read a problem from a user's file.

    The file defines ``name``, ``title``, ``Params`` (a pydantic model, :mod:`problems.parameters`)
    and ``build(params) -> Problem``, and may define ``equations``, ``draw``, ``frames``, ``axes``,
    ``golden``, ``citation`` and ``region``, as the files beside this one do.

    Raises :class:`~ocp.errors.InputError` where there is no such file, it raises (with the line),
    a name is missing or of the wrong kind, or the problem's dimensions do not fit.
    """
    file = expand_path(path).resolve()
    check_file(file)
    module, digest = _imported(file)
    found = read(module, file, digest)
    check(found)
    return found


def _imported(file: Path) -> tuple[ModuleType, str]:
    """A file's module, and the digest of all that it was made of."""
    before, tries = source_digest(file), 1
    module = import_file(file)
    # Edited while it was read, neither text is known to be the module's.
    while (digest := source_digest(file)) != before and tries < _TRIES:
        before, tries = digest, tries + 1
        module = import_file(file)
    return module, digest


@cache
def _module_of(name: str) -> ProblemSpec:
    return defined(ProblemSpec, importlib.import_module(_MODULES[name]), path=None)
