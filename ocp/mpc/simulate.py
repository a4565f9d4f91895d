"""Closed-loop simulation of a controller on a plant, repeated for several seeds of the noise."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import xarray as xr
from pydantic import InstanceOf

from dynamics.limits import INDEX, LOOP_SAMPLES, LOOP_SEEDS
from dynamics.settings import read_value
from ocp.errors import InputError
from ocp.judge.certificate import certify
from ocp.judge.constraint_rows import ConstraintRows
from ocp.judge.constraints import Broken
from ocp.judge.step_size import step_size_kind
from ocp.mpc.controller import Command, Controller
from ocp.mpc.phase import numbers
from ocp.mpc.plants import Disturbance, Plant, check_pushes, deviations
from ocp.mpc.receding import Values
from ocp.mpc.stages import Plan
from ocp.mpc.verdict import LoopVerdict
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains
from ocp.routes.session import Session
from ocp.validation import validated

DIVERGED_FACTOR = 100.0
"""Multiple of the largest of problem scales, start and first plan above which a state counts as diverged."""
FEASIBILITY_TOLERANCE = 1e-6
"""Constraint violation up to which a plan is judged for stationarity, in characteristic sizes."""
DEFAULT_NOISE_SHARE = 0.01
"""Default standard deviation of the noise of the plant ``noise``, in characteristic sizes."""

DIMENSIONS = {
    "x": ("node", "state"),
    "u": ("sample", "input"),
    "measured": ("sample", "state"),
    "plan": ("sample", "ahead", "state"),
    "cost": ("sample",),
    "seconds": ("sample",),
    "merit": ("sample",),
    "programs": ("sample",),
    "qp_iterations": ("sample",),
}
"""Mapping from names of a simulation's numeric arrays to their dimensions after ``seed``."""
Goals = Callable[[int, np.ndarray], Values]
"""Function ``(sample, measured state) -> parameters`` that returns the controller's parameters for each sample."""


@dataclass(frozen=True)
class ClosedLoop:
    """Result of a closed-loop simulation: trajectories of S seeds over T samples as labelled arrays, and counts.

    ``data`` has x (S, T+1, nx), u (S, T, nu), measured (S, T, nx), plan (S, T, N+1, nx), seconds, cost, merit,
    programs, qp_iterations, status and certificate (S, T), end_cost (S,), and ended (S,), the number of samples
    before the plant diverged. ``notes`` maps each note of the commands to its number of occurrences.
    ``violations`` are the plant's violations of path constraints and of bounds on states, largest first.
    ``gains`` are those of the controller after the last sample, or None. There are ``samples_per_step`` samples
    per step of a plan.
    """

    problem: Problem
    data: xr.Dataset
    notes: Mapping[str, int]
    misses: int
    record: dict[str, Any] = field(default_factory=dict)
    violations: list[Broken] = field(default_factory=list)
    gains: Gains | None = None
    samples_per_step: int = 1

    @cached_property
    def verdict(self) -> LoopVerdict:
        """Verdict with a status and sentences; ``ocp mpc`` prints ``str(loop.verdict)``."""
        return LoopVerdict(self)

    @property
    def stage_costs(self) -> np.ndarray:
        """Sum of the stage costs (S,), NaN for a seed that ended early."""
        return self.data["cost"].sum("sample", skipna=False).values

    @property
    def costs(self) -> np.ndarray:
        """Closed-loop cost (S,): sum of stage costs and terminal cost, NaN for a seed that ended early."""
        return self.stage_costs + self.data["end_cost"].values

    @property
    def cost_interval(self) -> tuple[float, float]:
        """Student's 95 % interval of the mean of the finite costs, NaN if there are fewer than two."""
        from scipy.special import stdtrit

        costs = self.costs[np.isfinite(self.costs)]
        n, mean = len(costs), float(costs.mean()) if len(costs) else np.nan
        half_width = float(stdtrit(n - 1, 0.975) * costs.std(ddof=1) / np.sqrt(n)) if n > 1 else np.nan
        return mean - half_width, mean + half_width

    @property
    def survived(self) -> np.ndarray:
        """Mask (S,) of the seeds that reached the last sample."""
        return self.data["ended"].values == self.data.sizes["sample"]

    @property
    def certified(self) -> float:
        """Fraction of stationary plans among the judged plans, NaN if no plan was judged."""
        certificates = self.data["certificate"].values
        was_judged = certificates != ""
        return float(np.isin(certificates[was_judged], ("B", "KKT")).mean()) if was_judged.any() else np.nan

    def percentile(self, share: float, skip: int = 10) -> float:
        """Return a percentile (0 to 100) of computing times [s], without the first ``skip`` samples of each seed."""
        seconds = self.data["seconds"].values[:, skip:]
        return float(np.nanpercentile(seconds, share)) if seconds.size else np.nan


def simulate(
    controller: Controller,
    steps: int,
    plant: str = "exact",
    disturbance: Disturbance | None = None,
    *,
    seeds: int = 1,
    seed: int = 0,
    x0: np.ndarray | None = None,
    goals: Goals | None = None,
    certify: int = 0,
    progress: Callable[[int, int, Command], None] | None = None,
) -> ClosedLoop:
    """Simulate a controller on a plant from ``x0`` (nx,) or (seeds, nx) for ``steps`` samples, once per seed.

    Every ``certify``-th plan is judged by an independent certificate, outside the measured time; with 0, no
    plan is judged. The noise of run s is stream s of ``seed``. A run ends if the plant diverges. Ctrl-C ends
    the simulation, and the samples until then are returned. With r samples per step of a plan, the plant takes
    steps of h / r, and a sample costs 1 / r of the stage cost, for impulses and changes of the input per step.

    Raises :class:`~ocp.errors.InputError` for counts below 1, starts of another shape or not finite, pushes after
    the last sample, samples after the end of a tracked plan and certificates of its shorter horizons, and the
    errors of :class:`Plant`.
    """
    disturbance = disturbance or Disturbance()
    validated("disturbance", disturbance, InstanceOf[Disturbance])
    steps, seeds = read_value("steps", steps, int, **LOOP_SAMPLES), read_value("seeds", seeds, int, **LOOP_SEEDS)
    seed, certify = read_value("seed", seed, int, **INDEX), read_value("certify", certify, int, **INDEX)
    nx = controller.problem.system.nx
    starts = controller.start if x0 is None else x0
    starts = np.broadcast_to(numbers("x0", starts, (nx,), (seeds, nx), finite=True), (seeds, nx))
    check_pushes(controller.problem, disturbance.pushes, steps)
    check_tracking(controller, steps, certify)
    simulated = Plant(controller.problem, plant, disturbance.mismatch, controller.samples_per_step)
    loop = _Loop(controller, simulated, disturbance, steps, seeds)
    loop.goals, loop.certify, loop.progress = goals, certify, progress
    if plant == "noise":
        loop.set_default_noise()
    stopped = False
    for s, stream in enumerate(np.random.SeedSequence(seed).spawn(seeds)):
        try:
            loop.run(s, starts[s], np.random.default_rng(stream))
        except KeyboardInterrupt:
            stopped = True
            break
    record = {
        "plant": plant,
        "steps": steps,
        "seeds": seeds,
        "seed": seed,
        "stopped": stopped,
        "phase": controller.phase,
        "law": controller.law.name,
    }
    return loop.result(record)


def check_tracking(controller: Controller, steps: int, certify: int) -> None:
    """Raise :class:`~ocp.errors.InputError` for samples after a tracked plan's end, and for certificates."""
    if controller.plan is None:
        return
    if steps > (most := controller.model.N * controller.samples_per_step):
        raise InputError(f"the tracked plan ends after {most} samples; simulate at most that many, not {steps}")
    if certify:
        raise InputError("certificates are of plans over the whole horizon, and a tracked plan gets shorter; drop them")


class _Loop:
    """Simulation in progress: its settings, and the arrays that it fills seed by seed."""

    def __init__(self, controller: Controller, plant: Plant, disturbance: Disturbance, steps: int, seeds: int) -> None:
        self.controller, self.plant, self.disturbance = controller, plant, disturbance
        self.goals: Goals | None = None
        self.progress: Callable[[int, int, Command], None] | None = None
        self.certify = 0
        problem, system = controller.problem, controller.problem.system
        self.states, self.inputs = ([signal.name for signal in signals] for signals in (system.states, system.inputs))
        self.sd_x = deviations(disturbance.noise_state, self.states, "noise-state")
        self.sd_u = deviations(disturbance.noise_input, self.inputs, "noise-input")
        sizes = {"node": steps + 1, "sample": steps, "ahead": problem.N + 1, "state": system.nx, "input": system.nu}
        self.arrays = {
            name: np.full((seeds, *(sizes[dimension] for dimension in dimensions)), np.nan)
            for name, dimensions in DIMENSIONS.items()
        }
        self.status = np.full((seeds, steps), "", dtype="<U12")
        self.certificate = np.full((seeds, steps), "", dtype="<U12")
        self.ended, self.end_cost = np.zeros(seeds, dtype=int), np.full(seeds, np.nan)
        self.notes: dict[str, int] = {}
        self.misses, self.steps, self.r = 0, steps, controller.samples_per_step
        self.impulses_per_step = np.array([self.r if " s" in signal.unit else 1 for signal in system.contacts])
        self.rows = ConstraintRows.of(problem)
        self.violation_amounts = np.zeros((seeds, steps, len(self.rows.names)))
        self._violation_function = ca.Function("off", problem.step_symbols, [-self.rows.expression])

    def set_default_noise(self) -> None:
        """Set the noise of the plant ``noise`` to 1 % of the characteristic sizes if the user gave no noise."""
        problem = self.controller.problem
        if not self.sd_x.any() and not self.sd_u.any():
            self.sd_x, self.sd_u = DEFAULT_NOISE_SHARE * problem.scales.x, DEFAULT_NOISE_SHARE * problem.scales.u
            step_size = step_size_kind(problem.system)
            if step_size.kind == "state":  # The step size is not measured.
                self.sd_x[step_size.state] = 0.0

    def run(self, s: int, x: np.ndarray, rng: np.random.Generator) -> None:
        """Simulate seed ``s`` from the state ``x`` (nx,) and store its samples."""
        controller, N = self.controller, self.controller.problem.N
        controller.reset()
        plan = controller.current_plan.x
        sizes = [controller.problem.scales.x, abs(x), *abs(plan[np.isfinite(plan).all(axis=1)])]
        max_state = DIVERGED_FACTOR * np.max(sizes, axis=0)
        last_input = waiting = controller.u_before
        inputs = deque([last_input] * self.r, self.r)
        for k in range(self.steps):
            self.arrays["x"][s, k] = x = x + np.asarray(self.disturbance.pushes.get(k, 0.0))
            measured = x + self.sd_x * rng.standard_normal(x.size)
            parameters = self.goals(k, measured) if self.goals else {}
            command = controller.step(measured, last_input, parameters)
            self._store_sample(s, k, measured, command)
            commanded = waiting if self.disturbance.delay else command.u
            waiting = command.u
            u = commanded + self.sd_u * rng.standard_normal(commanded.size)
            x_next, lam = self.plant.step(x, u)
            lam = lam * self.impulses_per_step
            terms, cost_arguments = controller.problem.cost_terms, (u, u - inputs[0], lam, controller.physical)
            self.arrays["u"][s, k] = u
            self.arrays["cost"][s, k] = float(terms(x, *cost_arguments)[0]) / self.r
            self.end_cost[s] = float(terms(x_next, *cost_arguments)[1])
            self.violation_amounts[s, k] = (
                ca.DM(self._violation_function(x, u, x_next, lam, controller.physical)).full().ravel()
            )
            x, last_input = x_next, u
            inputs.append(u)
            if not np.isfinite(x).all() or (abs(x) > max_state * (1 + k / (N * self.r))).any():
                return
            self.arrays["x"][s, k + 1] = x
            self.ended[s] = k + 1

    def _store_sample(self, s: int, k: int, measured: np.ndarray, command: Command) -> None:
        arrays = self.arrays
        arrays["measured"][s, k], arrays["seconds"][s, k] = measured, command.seconds
        arrays["merit"][s, k], self.status[s, k] = command.merit, command.status
        arrays["programs"][s, k], arrays["qp_iterations"][s, k] = command.programs, command.qp_iterations
        self.misses += command.status == "late"
        if command.plan is not None:
            arrays["plan"][s, k, : len(command.plan.x)] = command.plan.x
            if self.certify and k % self.certify == 0:
                values = self.controller.values_of_sample
                self.certificate[s, k] = certify_plan(self.controller.session, command.plan, values)
        for reason in filter(None, command.note.split("; ")):
            self.notes[reason] = self.notes.get(reason, 0) + 1
        if self.progress:
            self.progress(s, k, command)

    def result(self, record: dict[str, Any]) -> ClosedLoop:
        """Return the simulated seeds with labelled arrays."""
        variables = {name: (("seed", *dimensions), self.arrays[name]) for name, dimensions in DIMENSIONS.items()}
        variables |= {name: (("seed", "sample"), getattr(self, name)) for name in ("status", "certificate")}
        variables |= {name: (("seed",), getattr(self, name)) for name in ("ended", "end_cost")}
        data = xr.Dataset(variables, coords={"state": self.states, "input": self.inputs})
        was_run = np.isfinite(self.arrays["u"]).any(axis=(1, 2))
        violations = self.rows.violations(self.violation_amounts)
        data, gains = data.isel(seed=was_run), self.controller.gains
        return ClosedLoop(self.controller.problem, data, self.notes, self.misses, record, violations, gains, self.r)


def certify_plan(session: Session, plan: Plan, values: dict[str, float]) -> str:
    """Judge whether a plan is stationary: return ``B``, ``KKT``, ``not``, ``undecided`` or ``infeasible``.

    ``B`` means B-stationary under the exact law, ``KKT`` means stationary for the smoothed problem.
    """
    nlp = session.judging_nlp()
    blocks = {"x": plan.x[None, 1:], "u": plan.u[None], "lam": plan.lam[None], "gap": plan.gap[None]}
    point = nlp.variables.pack({k: v for k, v in blocks.items() if k in nlp.variables})
    p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
    if nlp.largest_violation(point, nlp.values(point, p)[1], bounds) > FEASIBILITY_TOLERANCE:
        return "infeasible"
    return certify(nlp, point, p, bounds).stationarity
