"""Studies: one figure of a paper each, one a folder; ``get("P6").data()`` runs one."""

from __future__ import annotations

from ocp.errors import InputError, did_you_mean
from problems.studies import (
    adaptive_mu,
    audited_theory,
    barrier_relaxation,
    bouncing_ball,
    friction_bias,
    heaviside_bias,
    impact_and_friction,
    interpolated_gradients,
    jumping_objectives,
    landing_variance,
    start_without_contact,
    stiff_pushing,
    wall_corner,
)
from problems.studies.study import Claim, Study

_STUDIES = {
    module.study.id: module.study
    for module in (
        start_without_contact,
        jumping_objectives,
        heaviside_bias,
        friction_bias,
        wall_corner,
        stiff_pushing,
        barrier_relaxation,
        interpolated_gradients,
        adaptive_mu,
        bouncing_ball,
        landing_variance,
        impact_and_friction,
        audited_theory,
    )
}


def ids() -> list[str]:
    """Identifiers of all studies, in the order of the papers."""
    return list(_STUDIES)


def get(name: str) -> Study:
    """Return the study called ``name``, upper or lower case.

    Raises :class:`~ocp.errors.InputError` for an unknown one.
    """
    known = {identifier.lower(): study for identifier, study in _STUDIES.items()}
    if name.lower() not in known:
        raise InputError(
            f"unknown figure {name!r}{did_you_mean(name, _STUDIES)}; there are"
            f" {', '.join(_STUDIES)}"
        )
    return known[name.lower()]


__all__ = ["Claim", "Study", "get", "ids"]
