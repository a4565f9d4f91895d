"""The packages above this one, loaded by entry point: named problems, reports of a solution.

They are found by the entry points that the distribution declares, never imported by name, so that
imports run one way only. Nothing of them is loaded before it is used.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from ocp.distribution import ShadowedPackage, shadowing
from ocp.errors import InputError

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
