"""What a solve returns: labelled trajectories, an audit and a verdict; and its replays."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.contact import ContactLaw
from dynamics.systems import LAW_PREFIX, Signal
from ocp.distribution import load_plugin
from ocp.errors import InputError
from ocp.judge.constraints import (
    Violation,
    broken_constraints,
    describe_violations,
    noticeable_violations,
    tolerance_sizes,
)
from ocp.judge.contact_report import least_slip
from ocp.judge.measures import Worst, between
from ocp.judge.verdict import Judgement
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, Rollout, roll_out
from ocp.transcription.factories import closing_law
from ocp.validation import expand_path

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from ocp.simulators.replay import InWorld


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
    problem: Problem,
    plan: xr.Dataset,
    planned_cost: float,
    gains: Gains | None,
    values: dict[str, float],
    law: ContactLaw,
) -> Replay:
    """Roll out what ``plan`` holds, or ``gains``, under ``law`` from the plan's own starts.

    Raises :class:`~ocp.errors.NotConverged` where a step of the law did not solve.
    """
    x = plan["x"].values
    inputs = plan["u"].values if gains is None else gains
    evaluation = Evaluation(problem, values)
    rolled = roll_out(problem, inputs, values, law, x[:, 0])
    seen = tolerance_sizes(problem, x)
    distance = evaluation.signed_distances(rolled.x)
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
        between=None if distance is None else between(evaluation, rolled.x),
        broken=noticeable_violations(broken_constraints(evaluation, rolled, seen)),
    )


def units_of(
    entries: Mapping[str, Sequence[Signal]],
) -> tuple[dict[str, list[str]], dict[str, dict[str, str]]]:
    """Units of signals by dimension, and attributes of arrays over it, which name them."""
    units = {key: [signal.unit for signal in found] for key, found in entries.items()}
    return units, {
        key: {"units": found[0] if len(set(found)) == 1 else f"see {key}_unit"} for key, found in units.items()
    }


def _labelled(problem: Problem, plan: xr.Dataset, rolled: Rollout, law: ContactLaw) -> xr.Dataset:
    import xarray as xr

    system = problem.system
    step = law.close(system)
    lam, gap = least_slip(step, rolled.lam, rolled.gap)
    entries = {"state": system.states, "control": system.inputs, "contact": step.contacts}
    units, one = units_of(entries)
    steps = ("scenario", "interval")
    coords = {
        **{key: [signal.name for signal in found] for key, found in entries.items()},
        **{name: plan[name] for name in ("time", "time_interval")},
    }
    data = {
        "x": (("scenario", "node", "state"), rolled.x, one["state"]),
        "u": ((*steps, "control"), rolled.u, one["control"]),
        "lam": ((*steps, "contact"), lam, one["contact"]),
        "gap": ((*steps, "contact"), gap, {"units": system.gap_unit}),
        "cost": ("scenario", rolled.costs, {"units": "1"}),
        **{f"{key}_unit": (key, found, {"units": "1"}) for key, found in units.items()},
    }
    return xr.Dataset(data, coords=coords)


@dataclass(frozen=True, repr=False)
class Solution(Judgement):
    """A solved (or not) problem, with what the judges say of it (:class:`~ocp.judge.verdict.Judgement`).

    ``data`` holds, labelled and with units, over dimensions scenario, node (N+1), interval (N),
    state, control, contact: ``x`` (scenario, node, state), ``u`` (scenario, interval, control),
    ``lam``, ``gap``, ``mu`` (scenario, interval, contact), their replay under the exact law
    ``x_replay``, ``u_replay``, ``lam_replay``, ``gap_replay`` (contact_exact: without branches),
    under the referee ``x_referee``, ``u_referee``,
    ``phi``, ``phi_replay`` (scenario, node, distance) where the system knows its signed distance,
    with friction ``normal_impulse``, ``friction_impulse``, ``slip``, ``friction_bound`` (friction
    times normal impulse) and, as 0 or 1, ``active``, ``slipping``, ``degenerate`` (scenario,
    interval, point) of every contact, and their ``_replay``, for feedback ``K`` (interval, control,
    state) and ``k`` (interval, control), and the homotopy's stages: ``stage_value``,
    ``stage_cost``, ``stage_complementarity``, ``stage_residual``, ``stage_iterations`` (stage), and
    ``stage_x``, ``stage_u`` (accepted_stage, scenario or shared, interval, state or control) of
    those that succeeded. Coordinate ``time`` [s].

    Of ``solve_s`` [s], ``evaluation_s`` went into evaluating cost, constraints and derivatives;
    ``solver_s``, the rest, into the solver: linear algebra, line search, its own affairs. It is
    NaN where that was not measured.

    ``run_hash`` is the content hash of the run from which the solution was read, "" elsewhere.
    """

    evaluation_s: float = math.nan
    run_hash: str = ""
    derivative: Callable[[str], xr.Dataset] | None = None

    def sensitivity(self, name: str) -> xr.Dataset:
        """How the solution changes per unit of a parameter: x, u and cost.

        See :mod:`ocp.judge.sensitivity`.
        Raises :class:`~ocp.errors.InputError` for an unknown name, for a point that is no solution,
        and where there is no derivative.
        """
        if self.derivative is None:
            raise InputError("a point that was not solved has no sensitivity; solve it first")
        return self.derivative(name)

    @property
    def inputs(self) -> np.ndarray | Gains:
        """Inputs of the plan (S, N, nu), or its policy."""
        return self.data["u"].values if self.gains is None else self.gains

    def with_route(self, **changes: Any) -> Solution:
        """Return the solution with fields of its :attr:`route` changed."""
        return replace(self, route=replace(self.route, **changes))

    @property
    def solver_s(self) -> float:
        """Seconds of the solve that were no evaluation of functions."""
        return self.solve_s - self.evaluation_s

    @property
    def iteration_s(self) -> dict[str, float]:
        """Mean seconds an iteration, ``evaluation`` and ``solver``; NaN where there was none."""
        count = self.iterations or math.nan
        return {"evaluation": self.evaluation_s / count, "solver": self.solver_s / count}

    def replay(
        self,
        contact: ContactLaw | str = "exact",
        contact_settings: Mapping[str, Any] | None = None,
        **parameters: Any,
    ) -> Replay:
        """Roll the plan out under another law, a name with its settings or an object.

        Open loop: the same inputs; feedback: the same policy from each scenario.

        Raises :class:`~ocp.errors.InputError` for a law that is none, or cannot close the system,
        and :class:`~ocp.errors.NotConverged` where one of its steps did not solve.
        """
        settings = {**(contact_settings or {}), **parameters}
        made = closing_law(contact, settings, self.problem.system)
        return replayed(self.problem, self.data, self.cost, self.gains, self.values, made)

    def replay_in(self, simulator: str = "mujoco") -> InWorld:
        """Replay the plan's inputs, or its policy, in another simulator.

        Raises :class:`~ocp.errors.InputError` as :func:`ocp.simulators.replay.in_world` does.
        """
        from ocp.simulators.replay import in_world

        start = self.data["x"].values[:, 0]
        return in_world(simulator, self.problem, self.inputs, self.values, start, self.cost)

    def plot(self) -> Figure:
        """Draw what ``ocp solve --plot`` writes: strobe above states, inputs and forces."""
        return load_plugin("reports").plot(self)

    def animate(self, path: Path | str, fps: int = 25, speed: float = 1.0) -> Path:
        """Write the motion, plan beside replay, to a .gif, .mp4 or .html, as ``ocp animate`` does.

        Raises :class:`~ocp.errors.InputError` for another ending, and for a problem not drawn.
        """
        return load_plugin("reports").animate(self, expand_path(path), fps, speed)

    def report(self, path: Path | str) -> Path:
        """Write the PDF of ``ocp report``; :class:`~ocp.errors.InputError` where it cannot be."""
        return load_plugin("reports").report(self, expand_path(path))

    def save(self, store: Path | str | None = None, tags: Sequence[str] = ()) -> Path:
        """Store it as ``ocp solve`` does and return the run's directory, for :func:`ocp.load`.

        ``store`` is the folder of runs, by default ``$OCP_RUNS``, else ``runs``; ``tags`` mark the run.

        Raises :class:`~ocp.errors.InputError` where ``store`` cannot be written, and for a tag that
        is no word.
        """
        # By name, since the store is built on solutions.
        runs = import_module("ocp.store")
        folder = runs.default_root() if store is None else store
        return runs.save(self, folder, ["python", Path(sys.argv[0]).name], tags).path

    def __repr__(self) -> str:
        request = self.record
        given = request["law_parameters"].items()
        parameters = "".join(f" {name.removeprefix(LAW_PREFIX)}={v:g}" for name, v in given)
        law = f"{request['contact']}{parameters}"
        how = f"{request['problem']}, {law}, {request['method']}, {request['policy']}"
        return f"<Solution of {how}: {self.headline}>"

    def _repr_html_(self) -> str:
        return load_plugin("reports").html(self)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a solve: ``solution`` is the best so far.

    Of several starts that is the best finished one; if none has finished, the best point of the
    first, with status :attr:`~ocp.programs.solver.Status.INTERRUPTED`.
    """

    def __init__(self, solution: Solution) -> None:
        super().__init__("interrupted; the best point so far is kept")
        self.solution = solution
