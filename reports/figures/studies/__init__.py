"""Drawings of the studies, by the study's identifier: each has a ``caption`` and a ``draw``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import xarray as xr
from matplotlib.figure import Figure

from reports.figures.policies import (
    convergence_bound,
    model_learning,
    smoothing_ablation,
    thrown_ball,
    trained_policies,
    unroll_variance,
)
from reports.figures.studies import (
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
    noised_contact,
    smoothings_compared,
    start_without_contact,
    stiff_pushing,
    theory_of_noising,
    wall_corner,
)


class Drawing(Protocol):
    """What a study's data look like, and the words below it."""

    caption: str
    draw: Callable[[xr.Dataset], Figure]


DRAWINGS: dict[str, Drawing] = {
    "N0": theory_of_noising,
    "N1": noised_contact,
    "N2": start_without_contact,
    "N3": smoothings_compared,
    "P1": jumping_objectives,
    "P2": heaviside_bias,
    "P3": friction_bias,
    "P4": wall_corner,
    "P5": stiff_pushing,
    "P6": barrier_relaxation,
    "P7": interpolated_gradients,
    "A1": adaptive_mu,
    "A2": bouncing_ball,
    "A2v": landing_variance,
    "A3": unroll_variance,
    "A4": trained_policies,
    "A5": smoothing_ablation,
    "A6": impact_and_friction,
    "A7": thrown_ball,
    "AM": model_learning,
    "AT": convergence_bound,
    "T1": audited_theory,
}
