"""What upper floors lend to this one: named problems, and pictures of a solution.

They are found by the entry points that the distribution declares, never imported by name, so that
imports run one way only; nothing of them is loaded before it is used.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from ocp.distribution import Hidden, hiding
from ocp.errors import InputError

GROUP = "centralpath.floors"


def lent(floor: str) -> Any:
    """Load the module by which ``floor``, "problems" or "reports", lends.

    Raises :class:`~ocp.errors.InputError` where the distribution is not installed, and
    :class:`~ocp.distribution.Hidden` where a user's module of that name is found instead.
    """
    found = [*entry_points(group=GROUP, name=floor)]
    if not found:
        raise InputError(
            f"the package {floor} of centralpath is not installed; install the distribution, as in"
            " pip install centralpath"
        )
    try:
        return found[0].load()
    except ImportError as error:
        if told := hiding((floor,)):
            raise Hidden(told) from error
        raise
