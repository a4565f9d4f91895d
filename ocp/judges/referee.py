"""What a plan is worth under the sharpest contact: its referee, its measures, its survival."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.physics.constraints import (
    Broken,
    broken_constraints,
    noticeable,
    seen_sizes,
    told,
    travelled,
)
from ocp.physics.measures import Physics, measure
from ocp.physics.parting import Parting, find_parting
from ocp.problem import Problem
from ocp.rollout import Gains, Rollout, Unsolved, roll_on, trajectory_costs

REFINEMENT = 4
"""By how much h is divided for the refined cost."""
COST_SHARE = 0.1
"""How much dearer than the plan, as a share of its cost, a replay may be that survives."""
STATE_SHARE = 0.1
"""How far its states may be from the plan's, as a share of their characteristic size."""
PENETRATION_SHARE = 0.1
"""How deep bodies may be in one another, at or between nodes, as a share of the characteristic gap.

At the nodes true gaps leave none but rounding. In between the straight way cuts corners: by a
hundredth of the gap where contacts roll, by whole bodies where one passes through another.
"""
_LEAST_COST, _LEAST_GAP = 1e-9, 1e-4


@dataclass(frozen=True)
class Referee:
    """A replay under the sharpest contact of the problem's system, the same h, and what it costs.

    ``replay`` is NaN from a step on that was not solved, which ``failed`` then names, and so is
    ``cost``. ``refined_cost`` is that at h/4, inputs or policy held over four steps and the cost
    summed over the problem's nodes; where it is NaN ``refined_note`` says why. ``note`` says what
    the referee has that the model has not; None for a system without geometry, which then referees
    itself.
    """

    replay: Rollout
    cost: float
    failed: Unsolved | None
    note: str | None
    refined_cost: float
    refined_note: str


def referee(
    problem: Problem, inputs: np.ndarray | Gains, values: dict[str, float], x0: np.ndarray
) -> Referee:
    """Replay ``inputs`` (S or 1, N, nu), or a policy, from x0 (S, nx) under the sharpest contact.

    ``values`` are parameter values by name. Never raises for a step without a solution.
    """
    replay, failed = roll_on(problem, inputs, values, problem.referee_step, x0)
    refined, why = _refined_cost(problem, inputs, values, x0)
    return Referee(replay, replay.cost, failed, problem.system.referee_note, refined, why)


def _refined_cost(
    problem: Problem, inputs: np.ndarray | Gains, values: dict[str, float], x0: np.ndarray
) -> tuple[float, str]:
    """Cost at h/4, or NaN and the reason."""
    system, h = problem.system, problem.system.h
    if not system.refinable:
        return math.nan, "the step size is part of the model"
    if any(signal.unit == "N s" for signal in system.inputs):
        return math.nan, "an input is the impulse of a step, which belongs to its size"
    chosen, named = _place(h, system.x), _place(h, system.parameters.vector)
    start, finer = np.array(x0, dtype=float), dict(values)
    if chosen is not None:
        start[:, chosen] /= REFINEMENT
    elif named is not None:
        finer[system.parameters.names[named]] /= REFINEMENT
    else:
        return math.nan, "the step size is no parameter of the model that could be turned"
    rolled, failed = roll_on(
        problem, inputs, finer, problem.referee_step, start, substeps=REFINEMENT
    )
    if failed is not None:
        return math.nan, str(failed)
    x = rolled.x.copy()
    if chosen is not None:
        x[:, :, chosen] *= REFINEMENT
    physical = problem.parameters.pack(values)
    return float(trajectory_costs(problem, x, rolled.u, physical).mean()), ""


def _place(symbol: ca.SX | float, among: ca.SX) -> int | None:
    """Position of a symbol in a column of symbols, None where it is none of them."""
    one = ca.SX(symbol)
    places = [i for i in range(among.numel()) if ca.is_equal(one, among[i])]
    return places[0] if places else None


@dataclass(frozen=True)
class Hearing:
    """All that is to be said of a plan's physics, see :func:`hear`.

    ``reasons`` are those why the plan does not survive, see :func:`survival`. ``planned`` and
    ``replayed`` measure plan and replay; ``broken`` are the constraints that the
    replay breaks by anything at all, the worst first; ``parting`` the first step of the plan that
    the model does not determine.
    """

    referee: Referee
    reasons: tuple[str, ...]
    planned: Physics
    replayed: Physics
    broken: tuple[Broken, ...]
    parting: Parting | None


def hear(
    problem: Problem,
    step: Step,
    plan: Rollout,
    values: dict[str, float],
    gains: Gains | None = None,
) -> Hearing:
    """Referee a plan that was made with ``step``, and measure both.

    The plan's inputs are replayed, or the policy where there is one, from the plan's own starts.
    """
    physical = problem.parameters.pack(values)
    heard = referee(problem, plan.u if gains is None else gains, values, plan.x[:, 0])
    there = heard.replay
    planned = measure(problem, step, plan.x, plan.u, plan.lam, physical)
    replayed = measure(problem, problem.referee_step, there.x, there.u, there.lam, physical)
    broken = tuple(
        broken_constraints(problem, there.x, there.u, physical, seen_sizes(problem, plan.x))
    )
    parting = find_parting(problem, plan.x, plan.u, plan.lam, values)
    reasons = survival(problem, plan, heard, replayed, broken)
    return Hearing(heard, reasons, planned, replayed, broken, parting)


def seen_gap(problem: Problem, x: np.ndarray) -> float:
    """Characteristic gap [m] to judge a plan x (S, N+1, nx): at most a third of the way it goes."""
    own = problem.sizes.gap
    way = [
        size for size, signal in zip(travelled(problem, x), problem.system.states, strict=True)
        if signal.unit == "m"
    ]  # fmt: skip
    return float(np.clip(min(way, default=np.inf) / 3, _LEAST_GAP * own, own))


def survival(
    problem: Problem, plan: Rollout, heard: Referee, physics: Physics, broken: Sequence[Broken]
) -> tuple[str, ...]:
    """Reasons why a refereed plan does not survive, each half a sentence; none where it does.

    It survives where the replay was solved throughout, costs at most :data:`COST_SHARE` more than
    the plan, keeps every state within :data:`STATE_SHARE`, every constraint within
    :data:`~ocp.physics.constraints.CONSTRAINT_SHARE` and its bodies apart to
    :data:`PENETRATION_SHARE` of the problem's characteristic sizes, which count for no more than
    the plan itself moves (:func:`~ocp.physics.constraints.seen_sizes`, :func:`seen_gap`).
    ``physics`` and ``broken`` are those of the replay.
    """
    excess = (heard.cost - plan.cost) / max(abs(plan.cost), _LEAST_COST * problem.sizes.cost)
    off = np.abs(heard.replay.x - plan.x)
    shares = off / seen_sizes(problem, plan.x)
    share = float(shares.max())
    reasons = []
    if heard.failed is not None:
        reasons.append(heard.failed.brief)
    elif not math.isfinite(share):
        reasons.append("it leads to states that are no numbers")
    elif not math.isfinite(heard.cost):
        reasons.append("its cost is no number there")
    if excess > COST_SHARE:
        reasons.append(f"it costs {heard.cost:.6g} instead of {plan.cost:.6g}")
    if share > STATE_SHARE:
        s, k, i = (int(v) for v in np.unravel_index(int(shares.argmax()), off.shape))
        signal = problem.system.states[i]
        reasons.append(f"{signal.name} is {off[s, k, i]:.2g} {signal.unit} off at node {k}")
    reasons += [f"its {words}" for words in told(noticeable(broken))]
    deep = seen_gap(problem, plan.x)
    for worst, where in ((physics.penetration, "node"), (physics.between, "step")):
        if worst is not None and worst.amount > PENETRATION_SHARE * deep:
            reasons.append(
                f"{worst.contact} is penetrated by {worst.amount:.2g} at {where} {worst.step}"
            )
            break
    return tuple(reasons)
