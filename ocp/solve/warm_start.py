"""Carry a solution to another NLP of its problem: other parameters, mesh, horizon, law, method.

A solution is the trajectories and, block by block, the multipliers that :func:`multipliers` adds
to its arrays. Quantities of an interval belong to its end, as the implicit steps here have it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import xarray as xr

from dynamics.contact import Step
from dynamics.systems import Signal
from ocp.errors import InputError
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.problem import Problem
from ocp.programs.layout import Layout
from ocp.programs.solver import Point
from ocp.solution import Solution
from ocp.transcription.nlp import NLP


class StoredPlan(NamedTuple):
    """Trajectories, ``problem``, ``method`` and status of a solution, as :func:`carry` reads them."""

    data: xr.Dataset
    record: dict[str, Any]
    status: Any


SIGNAL_BLOCKS = {
    "state": ("x", "x0", "dynamics", "x_bound"),
    "control": ("u", "policy", "u_bound"),
    "contact": ("lam", "gap", "gap_definition", "contact", "separation"),
}
"""Blocks whose last axis is states, inputs or contacts."""
BLOCK_SIGNALS = {name: kind for kind, names in SIGNAL_BLOCKS.items() for name in names}
"""Kind of the signals along the last axis of each block."""
_ONCE = {"terminal", "x0", "periodic"}
"""Blocks that belong to no step."""
_WHOLE = {"dynamics", "contact", "separation", "K", "k"}
"""Multipliers that a finer mesh leaves as they are; all others are shared out among the steps."""
_IMPULSE = "N s"
"""Unit of what scales with the step: half the step, half the impulse."""
_LEAST = 1e-12
"""Smallest mu, in characteristic units, whose path a pair is put on."""


def multipliers(nlp: NLP, point: Point) -> dict[str, Any]:
    """Name a point's multipliers by block, as variables of the dataset of a solution.

    ``lam_g_<block>`` belong to constraints, ``lam_x_<block>`` to bounds; both are zero where
    nothing holds, positive at upper bounds. A point without multipliers has none.
    """
    variables: dict[str, Any] = {}
    for prefix, vector, layout in (("lam_g", point.lam_g, nlp.constraints), ("lam_x", point.lam_x, nlp.variables)):
        if vector is None:
            continue
        for name, values in layout.unpack(vector).items():
            if values.size:
                dims = _dimensions(name, values.shape, nlp)
                variables[f"{prefix}_{name}"] = (dims, values, {"units": "cost per unit of the row"})
    return variables


def _dimensions(name: str, shape: tuple[int, ...], nlp: NLP) -> tuple[str, ...]:
    if name in ("K", "k"):
        steps = "interval" if shape[0] == nlp.problem.N else "once"
        return (steps, "control", "state")[: len(shape)]
    steps = "interval" if shape[1] == nlp.problem.N else "once"
    rows = "scenario" if shape[0] == nlp.problem.scenarios.n else "shared"
    return rows, steps, BLOCK_SIGNALS.get(name, f"{name}_row")


@dataclass(frozen=True)
class _Mesh:
    """Ends [s] of old and new intervals, matched by time unless there are as many."""

    old: np.ndarray
    new: np.ndarray

    @property
    def same(self) -> bool:
        return len(self.old) == len(self.new)

    @property
    def ratio(self) -> float:
        return float(self.new[0] / self.old[0])

    @property
    def beyond(self) -> np.ndarray:
        """Mask (N,) of new intervals that begin where the old trajectory has ended."""
        starts = self.new - self.new[0]
        return np.full(len(self.new), False) if self.same else starts > self.old[-1] * (1 - 1e-9)

    def interpolate(self, values: np.ndarray, axis: int, first: np.ndarray | None = None) -> np.ndarray:
        """Interpolate along an axis of intervals, ``first`` at time 0; hold beyond the ends."""
        if self.same or values.shape[axis] == 1:
            return values
        interval_values, times = np.moveaxis(values, axis, 0), self.old
        if first is not None:
            times = np.concatenate([[0.0], times])
            interval_values = np.concatenate([np.broadcast_to(first, interval_values.shape[1:])[None], interval_values])
        columns = interval_values.reshape(len(times), -1).T
        interpolated = np.stack([np.interp(self.new, times, column) for column in columns], axis=-1)
        return np.moveaxis(interpolated.reshape(-1, *interval_values.shape[1:]), 0, axis)


def carry(solution: Solution | StoredPlan, nlp: NLP, values: dict[str, float]) -> Point:
    """Write a solution into the variables and multipliers of ``nlp`` at parameter ``values``.

    As many steps are taken over one by one. With another number trajectories are interpolated in
    time, impulses scaled with the step; beyond the old end the last state and input are held with
    the contact that they have, and a shorter horizon cuts. Contacts of another law are solved
    anew. Where the law smooths, each pair is put on its central path, the larger member kept.

    Raises :class:`~ocp.errors.InputError` for a solution of another problem, or of one with other
    states or inputs, or one that is not finite.
    """
    _check(solution, nlp)
    carrier = _Carrier(solution, nlp.problem, values)
    x = nlp.variables.pack(carrier.variables(nlp))
    lam_g = carrier.duals("lam_g", nlp.constraints, nlp.method)
    lam_x = carrier.duals("lam_x", nlp.variables, nlp.method)
    if not lam_x or ("dynamics" in nlp.constraints and "dynamics" not in lam_g):
        # Without those of the dynamics the rest says little: the solver had better estimate all.
        return Point(x)
    if "contact" in nlp.constraints and "contact" not in lam_g and "gap" in lam_x:
        blocks = nlp.variables.unpack(x)
        lam_g["contact"] = _contact_duals(blocks["lam"], blocks["gap"], lam_x, nlp.step.exact)
    return Point(x, nlp.variables.pack(lam_x), nlp.constraints.pack(lam_g))


def carried_guess(
    solution: Solution | StoredPlan, problem: Problem, values: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """States (N+1, nx) and inputs (N, nu) of a solution, on the problem's mesh, as a guess."""
    carrier = _Carrier(solution, problem, values)
    x, u = carrier.trajectories()
    return np.concatenate([carrier.first_states(len(x)), x], axis=1).mean(axis=0), u.mean(axis=0)


def _check(solution: Solution | StoredPlan, nlp: NLP) -> None:
    name, system = nlp.problem.name, nlp.problem.system
    origin = str(solution.record.get("problem"))
    if origin != name:
        raise InputError(f"the run to start from is of {origin}, not of {name}; start from a run of {name}")
    if not all(np.isfinite(solution.data[key].values).all() for key in ("x", "u")):
        raise InputError(
            "the run to start from has NaN or infinite trajectories"
            f" ({getattr(solution.status, 'label', solution.status)}); start from a solved one"
        )
    for kind, dimension, signals in (("states", "state", system.states), ("inputs", "control", system.inputs)):
        solution_names = [str(value) for value in solution.data[dimension].values]
        problem_names = [signal.name for signal in signals]
        if solution_names != problem_names:
            raise InputError(
                f"the run to start from has {kind} {', '.join(solution_names)}, but {name} has"
                f" {', '.join(problem_names)} here; solve without --from, or with the run's parameters"
            )


def _contact_duals(lam: np.ndarray, gap: np.ndarray, lam_x: dict[str, np.ndarray], exact: bool) -> np.ndarray:
    """Multipliers of ``lam gap = mu`` (or <= t) from those of fixed pairs; changes ``lam_x``."""
    # A fixed pair's smaller member is held at zero by a force of either sign. It equals the
    # product's multiplier times the larger member; a bound takes what pulls below zero.
    active = lam > gap
    pair_forces = np.where(active, lam_x["gap"], lam_x["lam"])
    product_forces = np.maximum(pair_forces, 0.0) if exact else pair_forces
    lam_x["gap"] = np.where(active, pair_forces - product_forces, lam_x["gap"])
    lam_x["lam"] = np.where(active, lam_x["lam"], pair_forces - product_forces)
    return product_forces / np.maximum(np.where(active, lam, gap), _LEAST)


class _Carrier:
    """One solution on its way to another mesh of its problem."""

    def __init__(self, solution: Solution | StoredPlan, problem: Problem, values: dict[str, float]) -> None:
        self.solution, self.data = solution, solution.data
        self.values, self.problem = values, problem
        self.evaluation = Evaluation(problem, values)
        old = np.asarray(self.data["time"].values)
        # A step size that is a state keeps the old duration.
        new = np.linspace(0.0, old[-1], problem.N + 1)
        new = new if self.free_steps else self.evaluation.node_times()
        self.mesh = _Mesh(old[1:], new[1:])

    @property
    def free_steps(self) -> list[int]:
        """States that the step size is made of."""
        system = self.problem.system
        return ca.jacobian(ca.SX(system.h), system.x).sparsity().get_col()

    def first_states(self, rows: int) -> np.ndarray:
        """States x_0 (rows, 1, nx): the problem's, or the old ones where the start is chosen."""
        start_states = self.evaluation.initial_states[:, None]
        if self.problem.start is not None:
            start_states = self.data["x"].values[:, :1].mean(axis=0, keepdims=True)
            start_states[..., self.free_steps] *= self.mesh.ratio
        return np.broadcast_to(start_states, (rows, *start_states.shape[1:]))

    def _scenarios(self, array: np.ndarray) -> np.ndarray:
        """As many rows as there are scenarios; where that changed, each the mean of the old."""
        S = self.problem.scenarios.n
        if len(array) == S:
            return array
        return np.broadcast_to(array.mean(axis=0, keepdims=True), (S, *array.shape[1:]))

    def trajectories(self) -> tuple[np.ndarray, np.ndarray]:
        """States at the ends of intervals (S, N, nx) and inputs (S, N, nu)."""
        mesh, problem, old_states = self.mesh, self.problem, self.data["x"].values
        u_before = self.evaluation.limits.u_before if problem.uses_du else None
        x = mesh.interpolate(old_states[:, 1:], 1, old_states[:, 0].mean(axis=0)).copy()
        x[..., self.free_steps] *= mesh.ratio
        u = mesh.interpolate(self.data["u"].values, 1, u_before) * self._sizes(problem.system.inputs)
        return self._scenarios(x), self._scenarios(u)

    def variables(self, nlp: NLP) -> dict[str, np.ndarray]:
        """Values of the blocks of variables."""
        x, u = self.trajectories()
        blocks = {"x": x, "u": u, **self._gains(u, nlp)}
        if "x0" in nlp.variables:
            blocks["x0"] = self.first_states(1)
        if "u" in nlp.variables and nlp.variables["u"].shape[0] == 1:
            blocks["u"] = u.mean(axis=0, keepdims=True)
        if "lam" in nlp.variables:
            blocks["lam"], blocks["gap"] = self._contacts(x, u, nlp.step)
        return {name: value for name, value in blocks.items() if name in nlp.variables}

    def _sizes(self, signals: tuple[Signal, ...]) -> np.ndarray:
        """Factors (n,) of signals: impulses scale with the step, the rest stays."""
        return np.array([self.mesh.ratio if s.unit == _IMPULSE else 1.0 for s in signals])

    def _gains(self, u: np.ndarray, nlp: NLP) -> dict[str, np.ndarray]:
        if "K" not in nlp.variables:
            return {}
        steps = nlp.variables["K"].shape[0]
        if "K" not in self.data:
            return {"k": u.mean(axis=0)[:steps]}
        gains = {name: self.mesh.interpolate(self.data[name].values, 0) for name in ("K", "k")}
        return gains if steps > 1 else {n: v.mean(axis=0, keepdims=True) for n, v in gains.items()}

    def _contacts(self, x: np.ndarray, u: np.ndarray, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers and gaps of all intervals (S, N, n)."""
        p = step.p.pack(self.values)
        ahead = np.concatenate([self.first_states(len(x)), x[:, :-1]], axis=1)
        _, lam, gap, _ = at_steps(step.solve, ahead, u, p=p)
        names = [contact.name for contact in step.contacts]
        if [str(value) for value in self.data["contact"].values] == names:
            carried = [self._scenarios(self.mesh.interpolate(self.data[key].values, 1)) for key in ("lam", "gap")]
            covered = ~self.mesh.beyond[None, :, None]
            lam = np.where(covered, carried[0] * self._sizes(step.contacts), lam)
            gap = np.where(covered, carried[1], gap)
        if step.exact:
            return lam, gap
        _, _, mu = at_steps(step.relation, ahead, u, x, lam, p=p)
        return self._on_path(lam, gap, mu)

    def _on_path(self, lam: np.ndarray, gap: np.ndarray, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Keep the larger of each pair, in characteristic sizes; the other follows from mu."""
        size = self.problem.scales
        mu = np.maximum(mu, _LEAST * size.impulse * size.gap)
        active = lam / size.impulse > gap / size.gap
        share = np.sqrt(mu / (size.impulse * size.gap))
        large = np.maximum(np.maximum(lam / size.impulse, gap / size.gap), share)
        small = share**2 / large
        return np.where(active, large, small) * size.impulse, np.where(active, small, large) * size.gap

    def duals(self, prefix: str, layout: Layout, method: str) -> dict[str, np.ndarray]:
        """Multipliers of the blocks that both sides have."""
        duals: dict[str, np.ndarray] = {}
        same_method = self.solution.record.get("method") == method
        for name, block in layout.blocks.items():
            key = f"{prefix}_{name}"
            if key not in self.data or (name == "dynamics" and not same_method):
                continue
            old_values = self.data[key].values
            if not np.isfinite(old_values).all():
                return {}
            if old_values.shape[2:] != block.shape[2:] or old_values.ndim != len(block.shape):
                continue
            new_values = self._moved(name, old_values, block.shape[0])
            if new_values.shape == block.shape:
                duals[name] = new_values
        return duals

    def _moved(self, name: str, old_values: np.ndarray, rows: int) -> np.ndarray:
        is_gain = name in ("K", "k")
        new_values = old_values if name in _ONCE else self.mesh.interpolate(old_values, 0 if is_gain else 1)
        if not is_gain and len(old_values) != rows:
            # The cost is a mean over scenarios, so each multiplier is its scenario's share.
            scenario_share = new_values.sum(axis=0, keepdims=True) / rows
            new_values = np.broadcast_to(scenario_share, (rows, *new_values.shape[1:]))
        if name in _ONCE:
            return new_values
        if name not in _WHOLE and not self.mesh.same:
            new_values = new_values * self.mesh.ratio
        if name != "dynamics" and not is_gain:
            new_values = np.where(self.mesh.beyond[None, :, None], 0.0, new_values)
        return new_values
