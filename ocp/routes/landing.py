"""From a smoothed plan down to the exact law in shooting: roll it out, then settle its contacts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynamics.contact import Step
from ocp.programs.solver import Point, Result
from ocp.programs.status import Status
from ocp.rollout import Gains, Rollout, roll_out
from ocp.routes.branches import land
from ocp.routes.legs import Homotopy
from ocp.transcription.nlp import NLP


def embedded(nlp: NLP, plan: Rollout, gains: Gains | None) -> np.ndarray:
    """Write trajectories x (S, N+1, nx), u, lam, gap (S, N, .) into an NLP's variables."""
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


def plan_of(nlp: NLP, x: np.ndarray) -> tuple[np.ndarray | Gains, np.ndarray | None]:
    """Inputs or gains, and the start where that is chosen, out of an NLP's variables."""
    blocks = nlp.variables.unpack(x)
    plan = Gains(blocks["K"], blocks["k"]) if "K" in blocks else blocks["u"]
    return plan, blocks["x0"][:, 0] if "x0" in blocks else None


def rolled_down(
    source: NLP, point: np.ndarray, target: NLP, direct: NLP, follower: Homotopy, step: Step
) -> tuple[Result, Result | None]:
    """Roll a plan of ``source`` out under the exact ``step``, settle it, and pack ``target``.

    The limit of smoothed optima is short of the exact one by the square root of the last mu. Hence
    the rolled-out point is put into ``direct``, whose contacts are fixed as they are and whose rest
    is solved (:func:`~ocp.routes.branches.land`); its inputs, rolled out, are the answer where
    they cost no more. Then the settled point is returned beside it: the same plan, with contacts
    that are exactly open or closed, which a rollout's are to the step solver's tolerance.
    """
    values = follower.values

    def rolled_out(nlp: NLP, x: np.ndarray) -> tuple[Rollout, Gains | None, Result]:
        plan, start = plan_of(nlp, x)
        gains = plan if isinstance(plan, Gains) else None
        rolled = roll_out(target.problem, plan, values, step, start)
        there, p = Point(embedded(target, rolled, gains)), target.parameter_vector(values)
        return rolled, gains, Result.at(target, there, p, Status.SOLVED, "rolled out")

    rolled, gains, first = rolled_out(source, point)
    there = Point(embedded(direct, rolled, gains))
    settled, _, worked = land(follower, direct, replace(first, point=there), improving=False)
    if not worked:
        return first, None
    second = rolled_out(direct, settled.point.x)[2]
    return (second, settled) if second.f <= first.f + 1e-9 * abs(first.f) else (first, None)
