"""A step by a model that is no graph, between the graphs that ask it and take its answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from dynamics.contact.casadi_map import LearnedMap


@dataclass(frozen=True)
class Asked:
    """A step whose next state comes from a model of it, evaluated beside the graphs.

    - `queries: (x, theta, w, p) -> z`, where the model is asked, branch after branch
    - `closing: (x, theta, w, p, lam) -> (x_next, lam, cost)`

    In place of lam there is `LearnedStep.evaluated`: the model's outputs, and its Jacobians, which
    the adjoint needs.
    """

    with_p: ClassVar[tuple[str, ...]] = ("queries", "closing")

    queries: ca.Function
    closing: ca.Function
    model: LearnedMap
