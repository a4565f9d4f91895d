"""Plans on branches without solving anything: inputs rolled out under the exact law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.contact import Step
from ocp.problem import Problem
from ocp.programs.program import Program
from ocp.programs.solver import Point
from ocp.rollout import Gains, InitialGuess, Rollout, initial_guesses, roll_on

_SIZES = 0.03, 3.0
"""Of the noise, in characteristic units."""


@dataclass(frozen=True)
class RolloutStarts:
    """Rolls inputs out from the start of a ``guess``, and puts what happens into a program."""

    problem: Problem
    step: Step
    values: dict[str, float]
    guess: InitialGuess

    def point(self, program: Program, u: np.ndarray) -> Point | None:
        """Where inputs (N, nu) lead; None where a step is not solved."""
        rolled = self._rolled(u)
        return rolled and Point(pack_rollout(program, rolled, None))

    def around(self, program: Program, found: Sequence[Point], count: int) -> list[Point]:
        """Plans around the guess and what was ``found``, the cheapest first, one a schedule.

        ``count`` around each: itself, and others by a constant and two cosines of up to one period
        over the horizon, of every input, since on a body that moves on noise of single steps
        averages out. Their size is log-uniform from 0.03 to 3 characteristic units, seed 0; inputs
        keep their bounds.
        """
        sizes, N = self.problem.scales, self.problem.N
        physical = self.problem.parameters.pack(self.values)
        lower, upper = (np.array(v).ravel() for v in self.problem.limits(physical)[2:4])
        rng, (least, most) = np.random.default_rng(0), np.log(_SIZES)
        waves = np.cos(np.pi * np.outer(np.arange(3), (np.arange(N) + 0.5) / N))
        best: dict[bytes, Rollout] = {}
        for u in (self.guess[1], *(program.variables.unpack(one.x)["u"][0] for one in found)):
            size = np.exp(rng.uniform(least, most, (count, 1, 1)))
            size[0] = 0.0
            noise = size * (rng.standard_normal((count, sizes.u.size, 3)) @ waves)
            for moved in np.clip(u + sizes.u * noise.transpose(0, 2, 1), lower, upper):
                rolled = self._rolled(moved)
                if rolled is not None and np.isfinite(rolled.cost):
                    key = (rolled.lam / sizes.impulse > rolled.gap / sizes.gap).tobytes()
                    best[key] = min(best.get(key, rolled), rolled, key=lambda one: one.cost)
        cheapest = sorted(best.values(), key=lambda one: one.cost)
        return [Point(pack_rollout(program, one, None)) for one in cheapest]

    def perturbed(self, program: Program, count: int) -> list[Point]:
        """Where guessed inputs lead, the own and perturbed ones, ``count`` in all."""
        plans = initial_guesses(self.problem, self.values, count, 0, self.guess)
        there = (self.point(program, u) for _, u in plans)
        return [point for point in there if point is not None]

    def _rolled(self, u: np.ndarray) -> Rollout | None:
        start = self.guess[0][None, 0]
        rolled, unsolved = roll_on(self.problem, u[None], self.values, self.step, start)
        return rolled if unsolved is None else None


def pack_rollout(nlp: Program, plan: Rollout, gains: Gains | None) -> np.ndarray:
    """Write trajectories x (S, N+1, nx), u, lam, gap (S, N, .) into an Program's variables."""
    blocks = {
        "x0": plan.x[:, :1],
        "x": plan.x[:, 1:],
        "u": plan.u,
        "lam": np.maximum(plan.lam, 0.0),
        "gap": np.maximum(plan.gap, 0.0),
    }
    if gains is not None:
        blocks |= {"K": gains.K, "k": gains.k}
    # One row where all scenarios share it.
    return nlp.variables.pack({
        name: blocks[name][: block.shape[0]]
        for name, block in nlp.variables.blocks.items() if name in blocks
    })  # fmt: skip
