"""Compiled sample of a phase: its memory is filled from the model, and from plans and measurements at every sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dynamics.batch.engines.c_program import PROXIMAL
from dynamics.batch.engines.c_sample import CompiledSample, SampleSizes
from dynamics.batch.engines.compiler import CompilerError
from ocp.judge.constraint_rows import MET_TOLERANCE, PENALTIES, PENALTY_FALL
from ocp.judge.constraints import Broken
from ocp.mpc.active_set import ActiveSets
from ocp.mpc.horizon_qp import (
    MAX_LINEARISATION_ERROR,
    MAX_QP_ITERATIONS,
    PENALTY_CURVATURE,
    RESIDUAL_SHARE,
    TIGHT,
)
from ocp.mpc.linearised import EIGENVALUE_ROUNDING, FACTOR_FLOOR
from ocp.mpc.phase import Sample
from ocp.mpc.riccati import INPUT_CURVATURE_SHARE
from ocp.mpc.rollouts import FULL_STEP, STEP_SHARES, CandidateRollouts
from ocp.mpc.stages import MIN_PENALTY, Plan, StageModel

MAX_COUNT = 1 << 62
"""Number of iterations without a budget."""
IGNORED_PENETRATION = 1e-9
"""Penetration, in characteristic gaps, up to which it is not corrected."""
MAX_PROJECTIONS = 5
"""Maximum number of Gauss-Newton projections of a penetrating state."""
RANK_TOLERANCE = 1e-12
"""Smallest squared singular value of the distances' derivatives, relative to the largest one."""
MAX_SWEEPS = 60
"""Maximum number of sweeps of Jacobi's method for eigenvalues, which needs about 8."""


class Outcome(NamedTuple):
    """Outcome of a sample's programs: the best rollout with its merit, number and violated constraints.

    ``solved`` is true for a solved program, and ``usable`` also for one that was stopped. ``is_exchanged`` tells
    whether its active set has sides exchanged.
    """

    plan: Plan
    merit: float
    best: int
    violated: list[Broken]
    solved: bool
    usable: bool
    is_exchanged: bool


class PhaseSample:
    """Compiled linearisation, programs and candidates of a phase, with the state that its samples pass on.

    ``constants`` are those of the phase by their names in C. If ``product``, the law ``lam gap = mu`` is linearised.
    The constructor raises :class:`~dynamics.batch.engines.compiler.CompilerError` without a C compiler.
    """

    def __init__(
        self,
        model: StageModel,
        rollouts: CandidateRollouts,
        constants: Mapping[str, float],
        *,
        product: bool,
    ) -> None:
        program, merit, stage = rollouts.compiled, model.compiled_merit, model.compiled_stage
        if program is None or merit is None or stage is None:
            raise CompilerError("the steps are not compiled")
        self.model, self._program = model, program
        contacts, step_parameters = ActiveSets(model).contacts, program.derive(model.step.p.values[None]).size
        forces = {len(contact.friction) for contact in contacts}
        if len(forces) > 1:
            raise CompilerError(f"contacts have different numbers of friction forces, {sorted(forces)}")
        distances = [] if model.distances is None else [model.distances]
        sizes = SampleSizes(
            *(model.N, model.nx, model.nu, model.n, model.m, len(contacts)),
            max(forces, default=0),
            *(sum(function.output_sizes[0] for function in distances), len(model.names), step_parameters),
            *(len(model.of_problem), len(STEP_SHARES), model.problem.uses_du, model.costs_impulses, product),
        )
        method = {
            **{"SHARES": ", ".join(map(repr, STEP_SHARES.tolist())), "PENALTIES": ", ".join(map(repr, PENALTIES))},
            **{"PENALTY_CURVATURE": PENALTY_CURVATURE, "PENALTY_FALL": PENALTY_FALL, "MET_TOLERANCE": MET_TOLERANCE},
            **{"TIGHT_RESIDUAL": TIGHT.residual, "TIGHT_GAP": TIGHT.gap, "RESIDUAL_SHARE": RESIDUAL_SHARE},
            **{"MAX_LINEARISATION_ERROR": MAX_LINEARISATION_ERROR, "MAX_ITERATIONS": MAX_QP_ITERATIONS},
            **{"MIN_PENALTY": MIN_PENALTY, "FACTOR_FLOOR": FACTOR_FLOOR, "EIGENVALUE_ROUNDING": EIGENVALUE_ROUNDING},
            **{"MAX_PROJECTIONS": MAX_PROJECTIONS, "RANK_TOLERANCE": RANK_TOLERANCE, "MAX_SWEEPS": MAX_SWEEPS},
            **{"FULL_STEP": FULL_STEP, "INPUT_CURVATURE": INPUT_CURVATURE_SHARE / model.nu},
        }
        engines = merit, stage, *(function.compiled for function in distances if function.compiled)
        self._compiled = CompiledSample(program.engine, engines, sizes, {**method, **constants})
        self.arrays, scales = self._compiled.arrays, model.problem.scales
        widths = {"x": model.nx, "u": model.nu, "lam": model.n, "gap": model.n, "p": len(model.names)}
        rows = {name: model.N + (name in "xp") for name in widths}
        self._rows = {
            name: self.arrays[name][: rows[name] * width].reshape(rows[name], width) for name, width in widths.items()
        }
        # The plan in the memory, whose parameters and bounds are those of the present sample; None if others are there.
        self._loaded: Plan | None = None
        self.load(
            **dict(zip(("lam_size", "gap_size"), model.sizes, strict=True)),
            **{"cost": scales.cost, "x_size": scales.x, "ignored": IGNORED_PENETRATION * scales.gap},
            **{"tolerance": TIGHT, "compliance": model.compliance},
            **{"proximal": PROXIMAL / np.square(scales.u), "input_limit": rollouts.input_limit},
            contacts=np.ravel([(c.normal, *c.friction, c.slip) for c in contacts]),
        )

    def load(self, **values: np.ndarray | float | tuple[float, ...]) -> None:
        """Copy values to the beginnings of the arrays with their names."""
        for name, value in values.items():
            flattened = np.ravel(value)
            self.arrays[name][: flattened.size] = flattened

    @property
    def has_exchange(self) -> bool:
        """Whether the next program exchanges sides of pairs."""
        return bool(self.arrays["has_exchange"][0])

    def shift_exchange(self) -> None:
        """Shift the exchange of sides by one step."""
        self._compiled.shift_exchange()

    def _load_plan(self, plan: Plan, p: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> None:
        rows, n = self._rows, len(plan.u)
        self.arrays["steps"][0] = n
        rows["x"][: n + 1], rows["u"][:n], rows["lam"][:n], rows["gap"][:n] = plan.x, plan.u, plan.lam, plan.gap
        self.arrays["lower"][:], self.arrays["upper"][:] = bounds
        self._load_step_parameters(p)

    def _load_step_parameters(self, p: np.ndarray) -> None:
        self.arrays["p_step"][:] = self._program.derive(p[:1, self.model.of_step])[0]

    def extended(self, plan: Plan, p: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> Plan:
        """Return the plan shifted by a step, and extended by a step with the last feedback gain."""
        self._load_plan(plan, p, bounds)
        self._compiled.shift_plan()
        rows, n = self._rows, len(plan.u)
        self._loaded = Plan(*(rows[name][: n + (name == "x")].copy() for name in ("x", "u", "lam", "gap")))
        return self._loaded

    def step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the next state (nx,); the state itself if the step has no solution."""
        self._load_step_parameters(p)
        self._loaded = None
        self.arrays["state"][:] = x
        return self._compiled.take_step(u)

    def move_out(self, x: np.ndarray, physical: np.ndarray) -> np.ndarray:
        """Return a state moved out of contact by the smallest change in characteristic sizes."""
        self.arrays["state"][:], self.arrays["physical"][:] = x, physical
        self._compiled.move_out()
        return self.arrays["state"].copy()

    def prepare(self, plan: Plan, sample: Sample) -> bool:
        """Linearise a plan and set its gaps; return False if a step has no linearisation."""
        n = len(plan.u)
        if plan is not self._loaded:
            self._load_plan(plan, sample.p, sample.bounds)
        self._loaded = None
        self._rows["p"][: n + 1] = sample.p
        self.arrays["state"][:], self.arrays["u_before"][:] = sample.x, sample.u_before
        is_prepared = self._compiled.prepare()
        plan.gap = self._rows["gap"][:n].copy()
        return is_prepared

    @property
    def gains(self) -> np.ndarray:
        """Gains (n, nu, nx) of the regulator along the prepared plan."""
        n, nu, nx = int(self.arrays["steps"][0]), self.model.nu, self.model.nx
        return self.arrays["gains"][: n * nu * nx].reshape(n, nu, nx).copy()

    def answer(self, iterations: int | None) -> Outcome | None:
        """Solve programs at the prepared plan within a number of iterations; return None if no rollout is finite."""
        self.arrays["iterations"][0] = self.arrays["programs"][0] = 0
        self.arrays["budget"][0] = MAX_COUNT if iterations is None else iterations
        return self._best_rollout() if self._compiled.answer() else None

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of programs and of their iterations in the last answer."""
        return int(self.arrays["programs"][0]), int(self.arrays["iterations"][0])

    def start_merit(self) -> float:
        """Return the merit of the prepared plan's rollout, without or with feedback, whichever is lower."""
        self._compiled.roll_out_start()
        return float(self.arrays["merits"][:FULL_STEP].min())

    def _best_rollout(self) -> Outcome:
        arrays, model, best = self.arrays, self.model, int(self.arrays["best"][0])
        n = int(arrays["steps"][0])

        def rows(name: str, steps: int, size: int) -> np.ndarray:
            first = best * steps * size
            return arrays[name][first : first + steps * size].reshape(steps, size).copy()

        sizes = (
            ("states", n + 1, model.nx),
            ("inputs", n, model.nu),
            ("multipliers", n, model.n),
            ("gaps", n, model.n),
        )
        plan, violated = Plan(*(rows(*size) for size in sizes)), []
        if arrays["breaks_limits"][0]:
            violated = model.violations(rows("violations", n, model.m)[None])
        status, merit = int(arrays["status"][0]), float(arrays["merits"][best])
        return Outcome(plan, merit, best, violated, status == 1, status >= 0, bool(arrays["is_exchanged"][0]))
