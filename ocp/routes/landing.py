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
    """Write trajectories x (S, N+1, nx), u, lam, gap (S, N, .) into a direct transcription."""
    rows = nlp.variables["u"].shape[0]
    blocks = {
        "x0": plan.x[:, :1],
        "x": plan.x[:, 1:],
        "u": plan.u if rows == len(plan.u) else plan.u[:1],
        "lam": np.maximum(plan.lam, 0.0),
        "gap": np.maximum(plan.gap, 0.0),
    }
    if gains is not None:
        blocks |= {"K": gains.K, "k": gains.k}
    return nlp.variables.pack({k: v for k, v in blocks.items() if k in nlp.variables})


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
    problem, values = target.problem, follower.values
    plan, start = plan_of(source, point)
    rolled = roll_out(problem, plan, values, step, start)
    first = _packed(target, rolled, plan, values)
    x = embedded(direct, rolled, plan if isinstance(plan, Gains) else None)
    settled, _, worked = land(follower, direct, replace(first, point=Point(x)), improving=False)
    if not worked:
        return first, None
    plan, start = plan_of(direct, settled.point.x)
    second = _packed(target, roll_out(problem, plan, values, step, start), plan, values)
    return (second, settled) if second.f <= first.f + 1e-9 * abs(first.f) else (first, None)


def _packed(
    target: NLP, rolled: Rollout, plan: np.ndarray | Gains, values: dict[str, float]
) -> Result:
    blocks = {"x0": rolled.x[:, :1], "x": rolled.x[:, 1:], "u": rolled.u}
    if isinstance(plan, Gains):
        blocks |= {"K": plan.K, "k": plan.k}
    x = target.variables.pack({
        name: blocks[name][:1] if name == "u" and block.shape[0] == 1 else blocks[name]
        for name, block in target.variables.blocks.items()
    })  # fmt: skip
    f, g = target.f_g(x, target.parameter_vector(values))
    return Result(Point(x), float(f), np.array(g).ravel(), Status.SOLVED, "rolled out", 0, 0.0)
