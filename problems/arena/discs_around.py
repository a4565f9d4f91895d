"""Two discs without drag; the driven disc moves around the other and pushes it."""

from __future__ import annotations

from ocp.problem.problem import Problem
from problems.arena import discs_swap
from problems.parameters import quantity, structure

name = "discs-around"
title = "Two discs, one of them driven round the other (nosnoc)"
citation = discs_swap.citation
equations = discs_swap.equations
draw = discs_swap.draw


class Params(discs_swap.Params):
    """Parameters of ``discs-around``, those of ``discs-swap`` with other starts, goals and steps."""

    drag: float = quantity(0.0, "N", "drag of a disc at high speed", least=0)
    h: float = quantity(2 / 30, "s", "step size", above=0)
    N: int = structure(30, "number of steps", least=1)
    y1: float = quantity(-2.0, "m", "start of the driven disc, y")
    x2: float = quantity(-1.0, "m", "start of the other disc, x")
    y2: float = quantity(-1.0, "m", "start of the other disc, y")
    gx1: float = quantity(-1.0, "m", "goal of the driven disc, x")
    gy1: float = quantity(1.0, "m", "goal of the driven disc, y")
    gx2: float = quantity(0.0, "m", "goal of the other disc, x")


def build(params: Params) -> Problem:
    """Return the problem of ``discs-swap`` with these parameters."""
    return discs_swap.pose_discs(name, params)
