"""Points of a continuation, their comparison with the plans of neighbouring points, and the stored dataset."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ocp.continuation.events import Event
from ocp.errors import NotConverged
from ocp.judge.constraints import broken_constraints
from ocp.problem.evaluation import Evaluation
from ocp.problem.policy import Feedback
from ocp.problem.rollout import roll_out
from ocp.routes.session import Session
from ocp.solution import Solution

OUTLIER_SHARE = 1e-3
"""Cost reduction by a neighbour's plan that makes a point an outlier, as a share of the cost that a plan can change."""


@dataclass(frozen=True)
class CurvePoint:
    """One solved point: the parameter's value and the judged solution there.

    ``neighbour_cost`` is the cost of a neighbouring point's plan at this value, if that is lower; the point is then an
    outlier. Otherwise it is None.
    """

    value: float
    solution: Solution
    neighbour_cost: float | None = None

    @property
    def infinite_costs(self) -> list[str]:
        """Names of the costs that are not finite: planned, or replayed under the exact law."""
        costs = {"planned": self.solution.cost, "replayed": self.solution.audit.exact_cost}
        return [name for name, cost in costs.items() if not math.isfinite(cost)]

    @property
    def failure_reason(self) -> str:
        """Sentences that say why the curve ends at this point."""
        names = " and ".join(self.infinite_costs)
        return f"its cost, {names}, is not finite. " * bool(names) + self.solution.verdict

    def row(self) -> dict[str, Any]:
        """Return the point as a JSON-serialisable dict."""
        solution = self.solution
        return {
            "value": self.value,
            "status": solution.status.label,
            "success": solution.success,
            "cost": solution.cost,
            "exact_cost": solution.audit.exact_cost,
            "referee_cost": solution.referee.cost,
            "survives": solution.referee.survives,
            "stationarity": solution.certificate.stationarity,
            "iterations": solution.iterations,
            "complementarity": solution.audit.complementarity,
            "outlier": self.neighbour_cost is not None,
            "neighbour_cost": self.neighbour_cost,
        }


@dataclass
class Continuation:
    """A followed curve: points, events and iterations; ``break_reason`` says where and why it ended early, if so."""

    parameter: str
    points: list[CurvePoint] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    iterations: int = 0
    nlp_builds: int = 0
    break_reason: str | None = None


def with_neighbour_costs(session: Session, parameter: str, points: Sequence[CurvePoint]) -> list[CurvePoint]:
    """Return the points with ``neighbour_cost`` set if a neighbour's plan costs less at the point's value.

    Plans are rolled out under the exact law, and must satisfy all constraints. Under other laws, and with gains, points
    are returned unchanged.
    """
    if not session.complementary or isinstance(session.policy, Feedback):
        return list(points)
    compared = list[CurvePoint]()
    for index, point in enumerate(points):
        evaluation = Evaluation(session.problem, {**session.values, parameter: point.value})
        neighbours = [points[k] for k in (index - 1, index + 1) if 0 <= k < len(points)]
        least = min(_rolled_costs(evaluation, neighbours), default=math.inf)
        gain = point.solution.audit.exact_cost - least
        is_outlier = evaluation.cost_share(gain, least) > OUTLIER_SHARE
        compared.append(replace(point, neighbour_cost=least) if is_outlier else point)
    return compared


def _rolled_costs(evaluation: Evaluation, points: Sequence[CurvePoint]) -> Iterator[float]:
    """Yield the costs of the points' plans in exact rollouts that succeed and satisfy all constraints."""
    for point in points:
        try:
            rollout = roll_out(evaluation.problem, point.solution.data["u"].values, evaluation.values)
        except NotConverged:
            continue
        if math.isfinite(rollout.cost) and not broken_constraints(evaluation, rollout):
            yield rollout.cost


def curve_dataset(curve: Continuation) -> Any:
    """Return a dataset of the points and their trajectories over the dimension ``point``."""
    import xarray as xr

    stored_arrays = ("x", "u", "lam", "gap", "x_replay", "u_replay", "lam_replay", "gap_replay", "K", "k")
    datasets = [point.solution.data[[n for n in stored_arrays if n in point.solution.data]] for point in curve.points]
    data = xr.concat(datasets, dim="point", join="override", combine_attrs="override")
    data = data.assign_coords(value=("point", np.array([point.value for point in curve.points])))
    for key in ("cost", "exact_cost", "iterations", "complementarity"):
        data[key] = ("point", np.array([point.row()[key] for point in curve.points], dtype=float))
    return data
