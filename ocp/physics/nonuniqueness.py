"""Steps of a plan at which the model's contact has more than one solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.physics.measures import TrajectoryEvaluator
from ocp.problem import Problem
from ocp.rollout import at_steps

APART = 1e-2
"""Share of the states' characteristic size from which on two ends of a step are two."""
SATISFIED = 1e-5
"""Share of the characteristic sizes to which a plan's step must obey the exact relation.

A solver that stops at lam gap = 1e-8 N s m is a thousandth of both sizes off where both are near
zero; two ends that are further apart than :data:`APART` are not the same end, solved badly.
"""


@dataclass(frozen=True)
class Nonuniqueness:
    """A step from whose state and input the model's contact can go on in two ways.

    The plan's end obeys the exact relation, and so does another, ``distance`` away (largest
    difference of a state, the one called ``state``, in ``unit``); ``contacts`` are those whose
    impulses differ.

    A plan by direct transcription may use the better of the two; its replay takes the one at which
    the step's central path ends. Shooting plans through that same step and so has no choice, and
    under the barrier law at a small mu its answer is certified as that of a smooth problem.
    """

    step: int
    scenario: int
    contacts: tuple[str, ...]
    distance: float
    state: str
    unit: str


def find_nonuniqueness(
    problem: Problem, x: np.ndarray, u: np.ndarray, lam: np.ndarray, values: dict[str, float]
) -> Nonuniqueness | None:
    """Find the first step of a plan at which the model's exact step has another solution.

    x (S, N+1, nx), u (S, N, nu), lam (S, N, nlam). The step is solved from every state and input of
    the plan itself, so that no earlier difference grows into it. None where the plan obeys another
    law than the exact one, where it is a plan with branches, or where both agree.
    """
    step = problem.exact_step
    if lam.shape[2] != step.n:
        return None
    x_next, other, _, error = at_steps(step.solve, x[:, :-1], u, p=step.p.pack(values))
    apart = np.abs(x_next - x[:, 1:])
    distance = (apart / problem.scales.x).max(axis=2)
    solved = np.all(error <= SATISFIED, axis=2)
    two = solved & _obeys(problem, x, u, lam, values) & (distance > APART)
    if not two.any():
        return None
    k = int(np.flatnonzero(two.any(axis=0))[0])
    s = int(np.flatnonzero(two[:, k])[0])
    i = int((apart[s, k] / problem.scales.x).argmax())
    signal = problem.system.states[i]
    contacts = _differing(problem, lam[s, k], other[s, k])
    return Nonuniqueness(k, s, contacts, float(apart[s, k, i]), signal.name, signal.unit)


def _obeys(
    problem: Problem, x: np.ndarray, u: np.ndarray, lam: np.ndarray, values: dict[str, float]
) -> np.ndarray:
    """Whether the plan's own steps obey the exact relation, (S, N)."""
    system, scaling = problem.system, problem.scales
    physical = problem.parameters.pack(values)
    residual, gap = TrajectoryEvaluator(problem, system, x, u, lam, physical)(
        system.residual, system.gap
    )
    product = scaling.impulse * scaling.gap
    off = np.stack([-lam / scaling.impulse, -gap / scaling.gap, lam * gap / product])
    motion = np.abs(residual).max(axis=2, initial=0.0)
    return (off.max(axis=(0, 3), initial=0.0) <= SATISFIED) & (motion <= SATISFIED)


def _differing(problem: Problem, one: np.ndarray, other: np.ndarray) -> tuple[str, ...]:
    """Names of the contacts whose impulses, each (nlam,), are not the same."""
    system = problem.system
    apart = np.abs(one - other) > APART * problem.scales.impulse
    names = [signal.name for signal in system.contacts]
    first = {pair.contact: i for i, pair in reversed(list(enumerate(system.pairs)))}
    called = {
        contact: names[i] if system.forces is None or contact >= len(system.forces.names)
        else system.forces.names[contact]
        for contact, i in first.items()
    }  # fmt: skip
    return tuple(dict.fromkeys(
        called[pair.contact] for i, pair in enumerate(system.pairs) if apart[i]
    ))  # fmt: skip
