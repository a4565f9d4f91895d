"""Studies: one figure of a paper each, one a file; ``get("P6").data()`` runs one."""

from __future__ import annotations

import importlib
from functools import cache

from ocp.errors import InputError
from problems.spec import did_you_mean
from problems.studies.study import Claim, Study

_IDS = ("N2", "P1", "P2", "P3", "P4", "P5", "P6", "P7", "A1", "A2", "A2v", "A6", "T1")


def ids() -> list[str]:
    """Identifiers of all studies, in the order of the papers."""
    return list(_IDS)


def get(name: str) -> Study:
    """Return the study called ``name``, upper or lower case.

    Raises :class:`~ocp.errors.InputError` for an unknown one.
    """
    known = {identifier.lower(): identifier for identifier in _IDS}
    if name.lower() not in known:
        raise InputError(
            f"unknown figure {name!r}{did_you_mean(name, _IDS)}; there are {', '.join(_IDS)}"
        )
    return _load(known[name.lower()])


@cache
def _load(identifier: str) -> Study:
    return importlib.import_module(f"problems.studies.{identifier.lower()}").study


__all__ = ["Claim", "Study", "get", "ids"]
