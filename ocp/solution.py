"""Solutions: labelled trajectories, their judgement, and their replays."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.contact import ContactLaw
from dynamics.systems import LAW_PREFIX, Signal
from ocp import plugins
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
from ocp.labelled import LabelledArrays
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, policy_name, roll_out
from ocp.transcription.factories import make_law
from ocp.validation import expand_path

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from ocp.simulators.replay import ExternalReplay


@dataclass(frozen=True)
class Replay:
    """A rollout of the inputs, or the policy, of a plan under ``law``.

    ``data`` holds, labelled and with units as in :class:`~ocp.solution.Solution`, ``x`` (scenario,
    node, state), ``u`` (scenario, interval, control), ``lam`` and ``gap`` (scenario, interval,
    contact), ``cost`` (scenario).

    ``cost`` is the mean over scenarios, ``planned_cost`` the plan's cost under its own law, and
    ``state_gap`` the largest |x - planned x|. ``penetration`` [m] is measured by the true signed
    distance, or by the model's gaps if that is unknown; ``between`` is the penetration on straight
    lines from node to node, None without geometry. ``broken`` are the noticeable violations of
    constraints: the worst one of every kind, with its step. ``inputs`` is "open-loop", "feedback" or "controller".
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
        return "".join(f"; {clause}" for clause in describe_violations(self.broken))


def replay_plan(plan: Judgement, law: ContactLaw) -> Replay:
    """Return the rollout of a plan's inputs, or its policy, under ``law`` from the plan's starts.

    Raises :class:`~ocp.errors.NotConverged` if a step under the law is not solved.
    """
    problem, x = plan.problem, plan.arrays["x"]
    evaluation = Evaluation(problem, plan.values)
    rolled = roll_out(problem, plan.inputs, plan.values, law, x[:, 0])
    distances = evaluation.signed_distances(rolled.x)
    depths = -(rolled.gap if distances is None else distances)
    broken = broken_constraints(evaluation, rolled, tolerance_sizes(problem, x))
    return Replay(
        data=_label_replay(plan, rolled, law),
        problem=problem.name,
        law=law,
        inputs=policy_name(plan.inputs),
        cost=rolled.cost,
        planned_cost=plan.cost,
        state_gap=float(np.max(np.abs(rolled.x - x))),
        penetration=max(0.0, float(np.max(depths, initial=0.0))),
        between=None if distances is None else between(evaluation, rolled.x),
        broken=noticeable_violations(broken),
    )


def units_of(signals: Mapping[str, Sequence[Signal]]) -> tuple[dict[str, list[str]], dict[str, dict[str, str]]]:
    """Return mappings from dimensions to the units of their signals and to the attributes of arrays over them."""
    units = {dimension: [signal.unit for signal in group] for dimension, group in signals.items()}
    return units, {
        dimension: {"units": group[0] if len(set(group)) == 1 else f"see {dimension}_unit"}
        for dimension, group in units.items()
    }


def _label_replay(plan: Judgement, rolled: Rollout, law: ContactLaw) -> xr.Dataset:
    import xarray as xr

    system = plan.problem.system
    step = law.close(system)
    lam, gap = least_slip(step, rolled.lam, rolled.gap)
    signals = {"state": system.states, "control": system.inputs, "contact": step.contacts}
    units, attributes = units_of(signals)
    steps = ("scenario", "interval")
    coords = {
        **{dimension: [signal.name for signal in group] for dimension, group in signals.items()},
        **{name: plan.data[name] for name in ("time", "time_interval")},
    }
    arrays = {
        "x": (("scenario", "node", "state"), rolled.x, attributes["state"]),
        "u": ((*steps, "control"), rolled.u, attributes["control"]),
        "lam": ((*steps, "contact"), lam, attributes["contact"]),
        "gap": ((*steps, "contact"), gap, {"units": system.gap_unit}),
        "cost": ("scenario", rolled.costs, {"units": "1"}),
        **{f"{dimension}_unit": (dimension, group, {"units": "1"}) for dimension, group in units.items()},
    }
    return xr.Dataset(arrays, coords=coords)


@dataclass(frozen=True, repr=False)
class Solution(Judgement):
    """A plan for a problem, solved or not, with its judgement (:class:`~ocp.judge.verdict.Judgement`).

    ``data`` is labelled, with units, over the dimensions scenario, node (N+1), interval (N), state,
    control and contact; its coordinate ``time`` is in [s]. It contains

    - the plan: ``x`` (scenario, node, state), ``u`` (scenario, interval, control), and ``lam``, ``gap``,
      ``mu`` (scenario, interval, contact); with feedback also ``K`` (interval, control, state) and ``k``
      (interval, control);
    - its replay under the exact law, ``x_replay``, ``u_replay``, ``lam_replay``, ``gap_replay`` (over
      contact_exact, without branches), and by the referee, ``x_referee``, ``u_referee``;
    - ``phi``, ``phi_replay`` (scenario, node, distance) if the system has signed distances;
    - with friction ``normal_impulse``, ``friction_impulse``, ``slip``, ``friction_bound`` (friction times
      normal impulse) and, as 0 or 1, ``active``, ``slipping``, ``degenerate`` (scenario, interval, point)
      of every contact, and the same in the replay, with the suffix ``_replay``;
    - the homotopy's stages: ``stage_value``, ``stage_cost``, ``stage_complementarity``,
      ``stage_residual``, ``stage_iterations`` (stage), and ``stage_x``, ``stage_u`` (accepted_stage,
      scenario or shared, interval, state or control) of the stages that succeeded.

    Of ``solve_s`` [s], ``evaluation_s`` was spent on evaluating cost, constraints and derivatives, and
    the rest, ``solver_s``, in the solver, such as on linear algebra and line search. Both parts are NaN
    if they were not measured.

    ``run_hash`` is the content hash of the run from which the solution was read, "" for other solutions.
    """

    evaluation_s: float = math.nan
    run_hash: str = ""
    derivative: Callable[[str], xr.Dataset] | None = None

    def sensitivity(self, name: str) -> xr.Dataset:
        """Return the derivatives of x, u and cost with respect to a parameter, see :mod:`ocp.judge.sensitivity`.

        Raises :class:`~ocp.errors.InputError` for an unknown name, for a point that was not solved,
        and if the derivative does not exist.
        """
        if self.derivative is None:
            raise InputError("a point that was not solved has no sensitivity; solve it first")
        return self.derivative(name)

    def with_data(self, data: xr.Dataset) -> Solution:
        """Return the solution with other arrays."""
        return replace(self, arrays=LabelledArrays.of(data))

    def with_route(self, **changes: Any) -> Solution:
        """Return the solution with fields of its :attr:`route` changed."""
        return replace(self, route=replace(self.route, **changes))

    @property
    def fails_at_its_step(self) -> bool:
        """Whether a plan in a scene fails the referee at its own step size, as by motion through a body."""
        return bool(self.problem.system.scene) and self.referee.survives_at_h is False

    @property
    def solver_s(self) -> float:
        """Time of the solve that was not spent on evaluating functions [s]."""
        return self.solve_s - self.evaluation_s

    @property
    def iteration_s(self) -> dict[str, float]:
        """Mean time per iteration [s] in ``evaluation`` and in ``solver``; NaN without iterations."""
        count = self.iterations or math.nan
        return {"evaluation": self.evaluation_s / count, "solver": self.solver_s / count}

    def replay(
        self,
        contact: ContactLaw | str = "exact",
        contact_settings: Mapping[str, Any] | None = None,
        **parameters: Any,
    ) -> Replay:
        """Return the replay of the plan under another law, a name with its settings or an object.

        The replay uses the plan's inputs or, with feedback, its policy from the start of each scenario.

        Raises :class:`~ocp.errors.InputError` for a law that is unknown, or cannot close the system,
        and :class:`~ocp.errors.NotConverged` if one of its steps is not solved.
        """
        settings = {**(contact_settings or {}), **parameters}
        return replay_plan(self, make_law(contact, settings, self.problem.system))

    def replay_in(self, simulator: str = "mujoco", /, **settings: float | str) -> ExternalReplay:
        """Return the replay of the plan's inputs, or its policy, in another simulator.

        ``settings`` are the contact's time constant ``solref`` [s] and the longest step ``h`` [s].

        Raises :class:`~ocp.errors.InputError` as :func:`ocp.simulators.replay.replay_in_simulator` does.
        """
        from ocp.simulators.replay import replay_in_simulator

        start = self.arrays["x"][:, 0]
        return replay_in_simulator(simulator, self.problem, self.inputs, self.values, start, self.cost, settings)

    def plot(self) -> Figure:
        """Return the figure that ``ocp solve --plot`` writes: a strobe picture above states, inputs and forces."""
        return plugins.reports.plot(self)

    def animate(self, path: Path | str, fps: int = 25, speed: float = 1.0) -> Path:
        """Write an animation of plan and replay as .gif, .mp4 or .html, like ``ocp animate``, and return its path.

        Raises :class:`~ocp.errors.InputError` for another file type, and for a problem without a drawing.
        """
        return plugins.reports.animate(self, expand_path(path), fps, speed)

    def report(self, path: Path | str) -> Path:
        """Write the PDF of ``ocp report``, and return its path; raise :class:`~ocp.errors.InputError` if that fails."""
        return plugins.reports.report(self, expand_path(path))

    def __repr__(self) -> str:
        request = self.record
        law_parameters = request["law_parameters"].items()
        parameters = "".join(f" {name.removeprefix(LAW_PREFIX)}={v:g}" for name, v in law_parameters)
        law = f"{request['contact']}{parameters}"
        summary = f"{request['problem']}, {law}, {request['method']}, {request['policy']}"
        return f"<Solution of {summary}: {self.headline}>"

    def _repr_html_(self) -> str:
        return plugins.reports.html(self)


class Interrupted(KeyboardInterrupt):
    """Error for a solve interrupted by Ctrl-C; ``solution`` is the best solution so far.

    With several starts this is the best finished solution; if none has finished, it is the best point of
    the first start, with status :attr:`~ocp.programs.solver.Status.INTERRUPTED`.
    """

    def __init__(self, solution: Solution) -> None:
        super().__init__("interrupted; the best point so far is kept")
        self.solution = solution
