"""Studies: one figure of a paper each, one a file; ``get("P6").data()`` runs one."""

from __future__ import annotations

import importlib
from functools import cache

from ocp.errors import InputError
from problems.spec import did_you_mean
from problems.studies.study import Claim, Study

_IDS = {
    "N2": "start_without_contact",
    "P1": "jumping_objectives",
    "P2": "heaviside_bias",
    "P3": "friction_bias",
    "P4": "wall_corner",
    "P5": "stiff_pushing",
    "P6": "barrier_relaxation",
    "P7": "interpolated_gradients",
    "A1": "adaptive_mu",
    "A2": "bouncing_ball",
    "A2v": "landing_variance",
    "A6": "impact_and_friction",
    "T1": "audited_theory",
}


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
    return importlib.import_module(f"problems.studies.{_IDS[identifier]}.data").study


__all__ = ["Claim", "Study", "get", "ids"]
