"""A plan, or a policy, rolled out under another law: labelled, and compared with the plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from dynamics.contact import ContactLaw
from ocp.judges.audit import signed_distances
from ocp.physics.constraints import (
    Violation,
    broken_constraints,
    describe_violations,
    noticeable,
    seen_sizes,
)
from ocp.physics.least_slip import least_slip
from ocp.physics.measures import Worst, between
from ocp.problem import Problem
from ocp.rollout import Gains, Rollout, roll_out

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Replay:
    """What the inputs, or the policy, of a plan do under ``law``.

    ``data`` holds, labelled and with units as in :class:`~ocp.solution.Solution`, ``x`` (scenario,
    node, state), ``u`` (scenario, interval, control), ``lam`` and ``gap`` (scenario, interval,
    contact), ``cost`` (scenario).

    ``cost`` is the mean over scenarios, ``planned_cost`` the plan's under its own law,
    ``state_gap`` the largest |x - planned x|, ``penetration`` [m] by true signed distance, or by
    the model's gaps where that is unknown; ``between`` the same on the straight way from node to
    node, None without geometry; ``broken`` the constraints that are broken by what can be seen, the
    worst of every kind with its step; ``inputs`` are "open-loop" or "feedback".
    """

    data: xr.Dataset
    problem: str
    law: ContactLaw
    inputs: str
    cost: float
    planned_cost: float
    state_gap: float
    penetration: float
    between: Worst | None = None
    broken: list[Violation] = field(default_factory=list)

    def __repr__(self) -> str:
        return (
            f"<Replay of {self.problem} under {self.law.name}, {self.inputs}:"
            f" cost {self.cost:.6g}, planned {self.planned_cost:.6g}; the states differ by at most"
            f" {self.state_gap:.2g}, penetration {self.penetration:.2g} m{self._broken}>"
        )

    @property
    def _broken(self) -> str:
        return "".join(f"; {words}" for words in describe_violations(self.broken))


def replayed(
    problem: Problem, plan: xr.Dataset, planned_cost: float, gains: Gains | None,
    values: dict[str, float], law: ContactLaw,
) -> Replay:  # fmt: skip
    """Roll out what ``plan`` holds, or ``gains``, under ``law`` from the plan's own starts.

    Raises :class:`~ocp.errors.NotConverged` where a step of the law did not solve.
    """
    x = plan["x"].values
    inputs = plan["u"].values if gains is None else gains
    rolled = roll_out(problem, inputs, values, law, x[:, 0])
    physical = problem.parameters.pack(values)
    distance = signed_distances(problem, rolled.x, physical)
    deepest = -(rolled.gap if distance is None else distance)
    return Replay(
        data=_labelled(problem, plan, rolled, law),
        problem=problem.name,
        law=law,
        inputs="open-loop" if gains is None else "feedback",
        cost=rolled.cost,
        planned_cost=planned_cost,
        state_gap=float(np.max(np.abs(rolled.x - x))),
        penetration=max(0.0, float(np.max(deepest, initial=0.0))),
        between=None if distance is None else between(problem, rolled.x, physical),
        broken=noticeable(
            broken_constraints(problem, rolled.x, rolled.u, physical, seen_sizes(problem, x))
        ),
    )


def _labelled(problem: Problem, plan: xr.Dataset, rolled: Rollout, law: ContactLaw) -> xr.Dataset:
    import xarray as xr

    system = problem.system
    step = law.close(system)
    lam, gap = least_slip(step, rolled.lam, rolled.gap)
    entries = {"state": system.states, "control": system.inputs, "contact": step.contacts}
    units = {key: [signal.unit for signal in found] for key, found in entries.items()}
    one = {
        key: {"units": found[0] if len(set(found)) == 1 else f"see {key}_unit"}
        for key, found in units.items()
    }
    along = ("scenario", "interval")
    coords = {
        **{key: [signal.name for signal in found] for key, found in entries.items()},
        **{name: plan[name] for name in ("time", "time_interval")},
    }
    data = {
        "x": (("scenario", "node", "state"), rolled.x, one["state"]),
        "u": ((*along, "control"), rolled.u, one["control"]),
        "lam": ((*along, "contact"), lam, one["contact"]),
        "gap": ((*along, "contact"), gap, {"units": system.gap_unit}),
        "cost": ("scenario", rolled.costs, {"units": "1"}),
        **{f"{key}_unit": (key, found, {"units": "1"}) for key, found in units.items()},
    }
    return xr.Dataset(data, coords=coords)
