"""Expressions of a system along trajectories; penetration, reach, and steps with two solutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.contact import Step
from dynamics.systems import ContactSystem
from ocp.problem import Problem
from ocp.rollout import at_steps


class TrajectoryEvaluator:
    """Evaluates expressions in (x, u, x_next, lam, p) along trajectories, each (S, N, size).

    The system is the problem's or its sharpest. Trajectories are x (S, N+1, nx), u (S, N, nu), lam
    (S, N, nlam); ``physical`` the values of the problem's parameters.
    """

    def __init__(self, problem: Problem, system: ContactSystem, x: np.ndarray, u: np.ndarray,
                 lam: np.ndarray, physical: np.ndarray) -> None:  # fmt: skip
        self.symbols = [system.x, system.u, system.x_next, system.lam, problem.parameters.vector]
        self.values, self.physical = (x[:, :-1], u, x[:, 1:], lam), physical

    def __call__(self, *expressions: ca.SX) -> list[np.ndarray]:
        """Evaluate the expressions at every scenario and step."""
        outputs = [ca.densify(expression) for expression in expressions]
        function = ca.Function("evaluate", self.symbols, outputs)
        return at_steps(function, *self.values, p=self.physical)


def mean_multipliers(step: Step, lam: np.ndarray) -> np.ndarray:
    """Multipliers (S, N, nlam), averaged over a law's branches by their weights.

    NaN where the law has none, though the system has contacts: a learned law knows no forces.
    """
    if step.n < step.system.nlam:
        return np.full((*lam.shape[:2], step.system.nlam), np.nan)
    weights = np.array([node.weight for node in step.nodes])
    branches = lam.reshape(*lam.shape[:2], len(weights), step.system.nlam)
    return np.einsum("snbl,b->snl", branches, weights)


def distances(problem: Problem, x: np.ndarray, physical: np.ndarray) -> np.ndarray:
    """True signed distances phi at states x (..., nx) of a system with geometry, (..., n_phi)."""
    phi = problem.signed_distance
    assert phi is not None
    states = x.reshape(-1, x.shape[-1])
    found = phi.map(len(states))(states.T, physical)
    return np.array(found).T.reshape(*x.shape[:-1], -1)


ACTIVE = 1e-3
"""Share of the characteristic impulse above which a normal impulse counts as a force that acts."""
_SAMPLES = 16
_GOLDEN = (np.sqrt(5) - 1) / 2
_SECTIONS = 40


@dataclass(frozen=True)
class Worst:
    """The largest of something, at which contact, scenario and step; zero where there is none.

    At a node ``step`` is its number, else that of the interval.
    """

    amount: float
    contact: str
    scenario: int
    step: int


@dataclass(frozen=True)
class Physics:
    """Lengths that should be zero [m] (of a joint limit in its unit), None without geometry.

    ``penetration`` max(0, -phi) at the nodes; ``between`` the same along the straight way in the
    coordinates from node to node; ``force_distance`` the largest phi(x_next) at which a normal
    impulse above :data:`ACTIVE` of the characteristic one acts. Nodes that are no number count for
    nothing.
    """

    penetration: Worst | None
    between: Worst | None
    force_distance: Worst | None


def measure(
    problem: Problem, step: Step, x: np.ndarray, u: np.ndarray, lam: np.ndarray,
    physical: np.ndarray,
) -> Physics:  # fmt: skip
    """Measure trajectories x (S, N+1, nx), u (S, N, nu), lam (S, N, n) of a closed step."""
    if problem.signed_distance is None:
        return Physics(None, None, None)
    phi, names = distances(problem, x, physical), problem.system.distance_names
    system, impulse = step.system, mean_multipliers(step, lam)
    if system.forces is None:
        # In the order of the first ``phi``; a multiplier that is a force [N] stays one.
        impulse = impulse[:, :, [i for i, pair in enumerate(system.pairs) if pair.kind == "normal"]]
    else:
        at = TrajectoryEvaluator(problem, system, x, u, impulse, physical)
        impulse = at(system.forces.normal)[0]
    after = phi[:, 1:, : impulse.shape[2]]
    acting = np.where(impulse > ACTIVE * problem.scales.impulse, after, 0.0)
    return Physics(
        _worst(-phi, names),
        between(problem, x, physical),
        None if np.isnan(impulse).all() else _worst(acting, names),
    )


def _worst(amounts: np.ndarray, names: Sequence[str]) -> Worst:
    found = np.nan_to_num(amounts, nan=-np.inf)
    if not found.size:
        return Worst(0.0, "", 0, 0)
    s, k, i = (int(v) for v in np.unravel_index(int(np.argmax(found)), found.shape))
    return Worst(max(0.0, float(found[s, k, i])), names[i], s, k)


def between(problem: Problem, x: np.ndarray, physical: np.ndarray) -> Worst:
    """Deepest penetration on the straight ways between the nodes of x (S, N+1, nx)."""
    return _worst(-least_between(problem, x, physical), problem.system.distance_names)


def least_between(problem: Problem, x: np.ndarray, physical: np.ndarray) -> np.ndarray:
    """Least phi on the straight way from every node to the next, (S, N, n_phi), ends included.

    Sampled at 16 points and then searched by golden section around the least: exact where phi has
    one minimum between two samples, as for convex bodies that do not turn, whose distance is convex
    along the way.
    """
    start, way = x[:, :-1, None], np.diff(x, axis=1)[:, :, None]
    share = np.linspace(0, 1, _SAMPLES + 1)
    sampled = distances(problem, start + share[:, None] * way, physical)
    at = np.nan_to_num(sampled, nan=np.inf).argmin(axis=2)
    low, high = share[np.maximum(at - 1, 0)], share[np.minimum(at + 1, _SAMPLES)]
    own = np.arange(sampled.shape[3])

    def phi(t: np.ndarray) -> np.ndarray:
        # Every contact looks at its own place of the way, and only at its own distance there.
        return distances(problem, start + t[..., None] * way, physical)[:, :, own, own]

    least = sampled.min(axis=2)
    one, two = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    phi_one, phi_two = phi(one), phi(two)
    for _ in range(_SECTIONS):
        least = np.minimum(least, np.minimum(phi_one, phi_two))
        left = phi_one < phi_two
        low, high = np.where(left, low, one), np.where(left, two, high)
        new = np.where(left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        phi_new = phi(new)
        one, two = np.where(left, new, two), np.where(left, one, new)
        phi_one, phi_two = np.where(left, phi_new, phi_two), np.where(left, phi_one, phi_new)
    return np.minimum(least, np.minimum(phi_one, phi_two))


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
