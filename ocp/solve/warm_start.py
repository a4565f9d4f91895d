"""Transfer of a solution to an NLP of its problem with other parameters, mesh, horizon, law or method.

A solution consists of trajectories and, block by block, of the multipliers that :func:`multipliers` adds
to its arrays. Values of an interval belong to the time of its end, since steps are implicit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from dynamics.contact import Step
from dynamics.systems import Signal
from ocp.errors import InputError
from ocp.labelled import LabelledArrays
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.problem import Problem
from ocp.programs.layout import Layout
from ocp.programs.solver import Point
from ocp.solution import Solution
from ocp.transcription.nlp import NLP


class StoredPlan(NamedTuple):
    """The parts of a solution that :func:`carry` reads: arrays, record (``problem``, ``method``) and status."""

    arrays: LabelledArrays
    record: dict[str, Any]
    status: Any


SIGNAL_BLOCKS = {
    "state": ("x", "x0", "dynamics", "x_bound"),
    "control": ("u", "policy", "u_bound"),
    "contact": ("lam", "gap", "gap_definition", "contact", "separation"),
}
"""Mapping from a kind of signals to the blocks of an NLP whose last axis has one entry per such signal."""
BLOCK_SIGNALS = {name: kind for kind, names in SIGNAL_BLOCKS.items() for name in names}
"""Kind of the signals along the last axis of each block."""
_ONCE = {"terminal", "x0", "periodic"}
"""Blocks that occur once in an NLP instead of once per step."""
_WHOLE = {"dynamics", "contact", "separation", "K", "k"}
"""Blocks whose multipliers do not depend on the mesh; all others are proportional to the step size."""
_IMPULSE = "N s"
"""Unit of signals that are proportional to the step size: half the step, half the impulse."""
_LEAST = 1e-12
"""Lower limit of mu, in characteristic units, for the central path to which a pair is moved."""


def multipliers(nlp: NLP, point: Point) -> dict[str, Any]:
    """Return the multipliers of a point as variables of a solution's arrays, one for each block.

    ``lam_g_<block>`` belong to constraints, ``lam_x_<block>`` to bounds; both are zero at inactive limits and
    positive at upper limits. The dict is empty for a point without multipliers.
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
    """Ends [s] of old and new intervals, matched by time if their numbers differ, otherwise one by one."""

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
        """Mask (N,) of new intervals that begin after the end of the old trajectory."""
        starts = self.new - self.new[0]
        return np.full(len(self.new), False) if self.same else starts > self.old[-1] * (1 - 1e-9)

    def interpolate(self, values: np.ndarray, axis: int, first: np.ndarray | None = None) -> np.ndarray:
        """Return values interpolated along an axis of intervals, ``first`` at time 0, constant beyond the ends."""
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
    """Return a solution as variables and multipliers of ``nlp`` at parameter ``values``.

    If the numbers of steps are equal, values are copied step by step. Otherwise trajectories are interpolated
    in time, and impulses are scaled with the step; after the old end the last state and input are held, and
    the contacts there are solved for. Contacts are also solved for if the law differs. If the law smooths
    contact, each pair is moved to its central path, with its larger member unchanged.

    Raises :class:`~ocp.errors.InputError` for a solution of another problem, with other states or
    inputs, or with values that are not finite.
    """
    _check(solution, nlp)
    carrier = _Carrier(solution, nlp.problem, values)
    x = nlp.variables.pack(carrier.variables(nlp))
    lam_g = carrier.duals("lam_g", nlp.constraints, nlp.method)
    lam_x = carrier.duals("lam_x", nlp.variables, nlp.method)
    if not lam_x or ("dynamics" in nlp.constraints and "dynamics" not in lam_g):
        # Without multipliers of the dynamics the others are of little use: the solver estimates all of them.
        return Point(x)
    if "contact" in nlp.constraints and "contact" not in lam_g and "gap" in lam_x:
        blocks = nlp.variables.unpack(x)
        lam_g["contact"] = _contact_duals(blocks["lam"], blocks["gap"], lam_x, nlp.step.exact)
    return Point(x, nlp.variables.pack(lam_x), nlp.constraints.pack(lam_g))


def carried_guess(
    solution: Solution | StoredPlan, problem: Problem, values: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean states (N+1, nx) and inputs (N, nu) over a solution's scenarios, on the problem's mesh."""
    carrier = _Carrier(solution, problem, values)
    x, u = carrier.trajectories()
    return np.concatenate([carrier.first_states(len(x)), x], axis=1).mean(axis=0), u.mean(axis=0)


def _check(solution: Solution | StoredPlan, nlp: NLP) -> None:
    name, system = nlp.problem.name, nlp.problem.system
    origin = str(solution.record.get("problem"))
    if origin != name:
        raise InputError(f"the run to start from is of {origin}, not of {name}; start from a run of {name}")
    if not all(np.isfinite(solution.arrays[key]).all() for key in ("x", "u")):
        raise InputError(
            "the run to start from has NaN or infinite trajectories"
            f" ({getattr(solution.status, 'label', solution.status)}); start from a solved one"
        )
    for kind, dimension, signals in (("states", "state", system.states), ("inputs", "control", system.inputs)):
        solution_names = [str(value) for value in solution.arrays[dimension]]
        problem_names = [signal.name for signal in signals]
        if solution_names != problem_names:
            raise InputError(
                f"the run to start from has {kind} {', '.join(solution_names)}, but {name} has"
                f" {', '.join(problem_names)} here; solve without --from, or with the run's parameters"
            )


def _contact_duals(lam: np.ndarray, gap: np.ndarray, lam_x: dict[str, np.ndarray], exact: bool) -> np.ndarray:
    """Return the multipliers of ``lam gap = mu`` (or <= t) from multipliers of fixed pairs, and change ``lam_x``."""
    # The multiplier of a fixed pair's smaller member, held at zero, has either sign. It equals the
    # product's multiplier times the larger member; under the exact law its negative part stays with the bound.
    active = lam > gap
    pair_forces = np.where(active, lam_x["gap"], lam_x["lam"])
    product_forces = np.maximum(pair_forces, 0.0) if exact else pair_forces
    lam_x["gap"] = np.where(active, pair_forces - product_forces, lam_x["gap"])
    lam_x["lam"] = np.where(active, lam_x["lam"], pair_forces - product_forces)
    return product_forces / np.maximum(np.where(active, lam, gap), _LEAST)


class _Carrier:
    """Conversion of one solution to another mesh of its problem."""

    def __init__(self, solution: Solution | StoredPlan, problem: Problem, values: dict[str, float]) -> None:
        self.solution, self.arrays = solution, solution.arrays
        self.values, self.problem = values, problem
        self.evaluation = Evaluation(problem, values)
        old_times = self.arrays["time"]
        # A step size that is a state keeps the old duration.
        new_times = np.linspace(0.0, old_times[-1], problem.N + 1)
        new_times = new_times if self.free_steps else self.evaluation.node_times()
        self.mesh = _Mesh(old_times[1:], new_times[1:])

    @property
    def free_steps(self) -> list[int]:
        """Indices of the states on which the step size depends."""
        system = self.problem.system
        return ca.jacobian(ca.SX(system.h), system.x).sparsity().get_col()

    def first_states(self, rows: int) -> np.ndarray:
        """Return initial states (rows, 1, nx): those of the problem, or the old ones if the start is optimised."""
        start_states = self.evaluation.initial_states[:, None]
        if self.problem.start is not None:
            start_states = self.arrays["x"][:, :1].mean(axis=0, keepdims=True)
            start_states[..., self.free_steps] *= self.mesh.ratio
        return np.broadcast_to(start_states, (rows, *start_states.shape[1:]))

    def _scenarios(self, array: np.ndarray) -> np.ndarray:
        """Return an array with one row per scenario; if their number has changed, each row is the old rows' mean."""
        S = self.problem.scenarios.n
        if len(array) == S:
            return array
        return np.broadcast_to(array.mean(axis=0, keepdims=True), (S, *array.shape[1:]))

    def trajectories(self) -> tuple[np.ndarray, np.ndarray]:
        """Return states at the ends of intervals (S, N, nx) and inputs (S, N, nu)."""
        mesh, problem, old_states = self.mesh, self.problem, self.arrays["x"]
        u_before = self.evaluation.limits.u_before if problem.uses_du else None
        x = mesh.interpolate(old_states[:, 1:], 1, old_states[:, 0].mean(axis=0)).copy()
        x[..., self.free_steps] *= mesh.ratio
        u = mesh.interpolate(self.arrays["u"], 1, u_before) * self._sizes(problem.system.inputs)
        return self._scenarios(x), self._scenarios(u)

    def variables(self, nlp: NLP) -> dict[str, np.ndarray]:
        """Return a dict from each block of the NLP's variables to its values."""
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
        """Return factors (n,) for signals: the ratio of step sizes for impulses, 1 for others."""
        return np.array([self.mesh.ratio if s.unit == _IMPULSE else 1.0 for s in signals])

    def _gains(self, u: np.ndarray, nlp: NLP) -> dict[str, np.ndarray]:
        if "K" not in nlp.variables:
            return {}
        steps = nlp.variables["K"].shape[0]
        if "K" not in self.arrays:
            return {"k": u.mean(axis=0)[:steps]}
        gains = {name: self.mesh.interpolate(self.arrays[name], 0) for name in ("K", "k")}
        return gains if steps > 1 else {n: v.mean(axis=0, keepdims=True) for n, v in gains.items()}

    def _contacts(self, x: np.ndarray, u: np.ndarray, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """Return the contact multipliers and gaps of all intervals, (S, N, n) each."""
        p = step.p.pack(self.values)
        states_before = np.concatenate([self.first_states(len(x)), x[:, :-1]], axis=1)
        _, lam, gap, _ = at_steps(step.solve, states_before, u, p=p)
        names = [contact.name for contact in step.contacts]
        if [str(value) for value in self.arrays["contact"]] == names:
            interpolated = [self._scenarios(self.mesh.interpolate(self.arrays[key], 1)) for key in ("lam", "gap")]
            covered = ~self.mesh.beyond[None, :, None]
            lam = np.where(covered, interpolated[0] * self._sizes(step.contacts), lam)
            gap = np.where(covered, interpolated[1], gap)
        if step.exact:
            return lam, gap
        _, _, mu = at_steps(step.relation, states_before, u, x, lam, p=p)
        return self._on_path(lam, gap, mu)

    def _on_path(self, lam: np.ndarray, gap: np.ndarray, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return multipliers and gaps with ``lam gap = mu``; the smaller of each pair, in its size, is changed."""
        size = self.problem.scales
        mu = np.maximum(mu, _LEAST * size.impulse * size.gap)
        active = lam / size.impulse > gap / size.gap
        share = np.sqrt(mu / (size.impulse * size.gap))
        large = np.maximum(np.maximum(lam / size.impulse, gap / size.gap), share)
        small = share**2 / large
        return np.where(active, large, small) * size.impulse, np.where(active, small, large) * size.gap

    def duals(self, prefix: str, layout: Layout, method: str) -> dict[str, np.ndarray]:
        """Return a dict from the blocks that both NLPs have to their multipliers; empty if some are not finite."""
        duals: dict[str, np.ndarray] = {}
        same_method = self.solution.record.get("method") == method
        for name, block in layout.blocks.items():
            key = f"{prefix}_{name}"
            if key not in self.arrays or (name == "dynamics" and not same_method):
                continue
            old_values = self.arrays[key]
            if not np.isfinite(old_values).all():
                return {}
            if old_values.shape[2:] != block.shape[2:] or old_values.ndim != len(block.shape):
                continue
            new_values = self._on_new_mesh(name, old_values, block.shape[0])
            if new_values.shape == block.shape:
                duals[name] = new_values
        return duals

    def _on_new_mesh(self, name: str, old_values: np.ndarray, rows: int) -> np.ndarray:
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
