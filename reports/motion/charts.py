"""Curves under a motion: contact forces of the plan and of its replay, and what both cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ocp.problem import Problem
from ocp.rollout import at_steps
from reports.forces import forces_of
from reports.motion.animation import Animation, Motion
from reports.motion.scene import LEAST
from reports.style import CYCLE, PLANNED, REPLAYED
from reports.units import powers
from reports.view import RunView

_ROOM = 0.06

Chart = dict[str, Any]
"""``title label range [low, high] wide`` and ``curves`` of ``name values color dash``.

``values`` belong to the nodes (N+1,), or to the steps between them (N,); costs have an ``end``.
"""


def charts(animation: Animation) -> list[Chart]:
    """Forces of each motion beside each other on one scale, and the costs of both below."""
    view = animation.view
    known = [forces for motion in animation.motions if (forces := _forces(view, motion))]
    drawn = [curve["values"] for chart in known for curve in chart["curves"]]
    highest = max((float(np.nanmax(values)) for values in drawn), default=0.0)
    for chart in known:
        chart["range"] = _widened(0.0, highest)
    if (paid := _costs(view, animation.motions)) is not None:
        known.append(paid)
    return known


def _forces(view: RunView, motion: Motion) -> Chart | None:
    """Size of the force of every contact that acts in the plan or in the replay."""
    found = {suffix: forces_of(view, suffix) for suffix in ("", "_replay")}
    sizes = {
        suffix: np.hypot(forces.normal, forces.friction)
        for suffix, forces in found.items() if forces is not None
    }  # fmt: skip
    own = sizes.get(motion.suffix)
    if own is None:
        return None
    most = np.max([np.nanmax(size, axis=0, initial=0.0) for size in sizes.values()], axis=0)
    acting = np.flatnonzero((most > LEAST * most.max(initial=0.0)) & (most > 0))
    if not acting.size:
        return None
    names = _contact_names(view, own.shape[1])
    forces = found[motion.suffix]
    assert forces is not None
    return {
        "title": f"contact forces, {'replayed' if motion.suffix else 'planned'}",
        "label": f"{'impulse' if forces.unit == 'N s' else 'force'} [{powers(forces.unit)}]",
        "wide": False,
        "curves": [
            {"name": names[i], "values": own[:, i], "color": CYCLE[place % len(CYCLE)],
             "dash": place // len(CYCLE) % 3}
            for place, i in enumerate(acting)
        ],
    }  # fmt: skip


def _contact_names(view: RunView, count: int) -> list[str]:
    if "point" in view.run.data.coords and view.run.data.sizes["point"] == count:
        return [str(name) for name in view.run.data["point"].values]
    return [signal.name for signal in view.signals("contacts")]


def _costs(view: RunView, motions: Sequence[Motion]) -> Chart | None:
    curves = []
    for motion, name, color in zip(
        motions, ("planned", "replayed"), (PLANNED, REPLAYED), strict=False
    ):
        paid = cost_so_far(view, motion.suffix)
        if paid is None:
            return None
        curves.append({"name": name, "values": paid[0], "end": paid[1], "color": color, "dash": 0})
    ends = [curve["end"] for curve in curves]
    finite = np.concatenate([*(curve["values"] for curve in curves), ends])
    finite = finite[np.isfinite(finite)]
    return {
        "title": "cost so far, at the end with the terminal cost",
        "label": "cost",
        "wide": True,
        "range": _widened(float(finite.min()), float(finite.max())),
        "curves": curves,
    }


def cost_so_far(view: RunView, suffix: str) -> tuple[np.ndarray, float] | None:
    """Sum of the stage costs before each node (N+1,), and all of it with the terminal cost.

    Of scenario 0, at the stored parameters; None for what is not a problem with costs.
    """
    problem, x, u = view.problem, view.array(f"x{suffix}"), view.array(f"u{suffix}")
    if not isinstance(problem, Problem) or x is None or u is None:
        return None
    p = problem.parameters.values
    before = np.array(problem.limits(p)[1]).ravel()
    du = np.diff(np.concatenate([before[None], u[0]]), axis=0)
    stage, _ = at_steps(problem.cost_terms, x[:1, :-1], u[:1], du[None], p=p)
    _, terminal = at_steps(problem.cost_terms, x[:1, -1:], u[:1, -1:], du[None, -1:], p=p)
    so_far = np.concatenate([[0.0], np.cumsum(stage[0, :, 0])])
    return so_far, float(so_far[-1] + terminal.item())


def _widened(low: float, high: float) -> list[float]:
    """A range with zero and room above, and below where there is something; never empty."""
    low, high = min(low, 0.0), max(high, 0.0)
    room = _ROOM * (high - low) or 0.5
    return [low - room if low < 0 else 0.0, high + room]
