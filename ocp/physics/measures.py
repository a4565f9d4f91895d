"""What a trajectory does to the bodies' geometry and to the problem's constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.physics.along import distances, normal_impulses
from ocp.problem import Constraint, Problem
from ocp.rollout import at_steps
from ocp.transcription.common import constraint_names

ACTS = 1e-3
"""Share of the characteristic impulse above which a normal impulse counts as a force that acts."""
_SAMPLES = 16
_GOLDEN = (np.sqrt(5) - 1) / 2
_SECTIONS = 40


@dataclass(frozen=True)
class Violation:
    """One violated constraint by name, with scenario, step, and how far it is off."""

    name: str
    component: str
    scenario: int
    step: int
    amount: float


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
    impulse above :data:`ACTS` of the characteristic one acts. Nodes that are no number count for
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
    impulse = normal_impulses(problem, step, x, u, lam, physical)
    after = phi[:, 1:, : impulse.shape[2]]
    acting = np.where(impulse > ACTS * problem.sizes.impulse, after, 0.0)
    return Physics(
        _worst(-phi, names),
        _worst(-least_between(problem, x, physical), names),
        None if np.isnan(impulse).all() else _worst(acting, names),
    )


def _worst(amounts: np.ndarray, names: Sequence[str]) -> Worst:
    found = np.nan_to_num(amounts, nan=-np.inf)
    if not found.size:
        return Worst(0.0, "", 0, 0)
    s, k, i = (int(v) for v in np.unravel_index(int(np.argmax(found)), found.shape))
    return Worst(max(0.0, float(found[s, k, i])), names[i], s, k)


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


@dataclass(frozen=True)
class Broken:
    """A violated constraint, and by how much of the characteristic size of what it bounds.

    For a bound or periodicity that size is the reference's of states or inputs; for a path or
    terminal constraint what its expression changes by when state and input change by theirs, to
    first order. So the share does not depend on how the constraint is written.
    """

    violation: Violation
    share: float


def broken_constraints(
    problem: Problem, x: np.ndarray, u: np.ndarray, physical: np.ndarray
) -> list[Broken]:
    """Find what trajectories x (S, N+1, nx), u (S, N, nu) violate, each entry where it is worst.

    Bounds of states and inputs, path and terminal constraints, and the periodicity of a start that
    is chosen; the worst first. What is no number is no violation: say that it was not replayed.
    """
    u_low, u_high, x_low, x_high = (np.array(v).ravel() for v in problem.limits(physical)[2:])
    system, sizes = problem.system, problem.sizes
    states, inputs = ([signal.name for signal in part] for part in (system.states, system.inputs))
    after = x[:, 1:]
    found = [
        *_worst_entries("bound on x", states, _off(after, x_low, x_high), sizes.x, 1),
        *_worst_entries("bound on u", inputs, _off(u, u_low, u_high), sizes.u),
    ]
    for kind, constraints in (("path", problem.path), ("terminal", problem.terminal)):
        if constraints:
            at = (x[:, :-1], u) if kind == "path" else (x[:, -1:], u[:, -1:])
            off, size = _constraints_off(problem, constraints, *at, physical)
            first = 0 if kind == "path" else problem.N
            names = constraint_names(constraints)
            found += _worst_entries(kind, names, off, size, first)
    if problem.start is not None and problem.start.periodic:
        which = list(problem.start.periodic)
        off = np.abs(x[:, -1:, which] - x[:, :1, which])
        names = [states[i] for i in which]
        found += _worst_entries("periodic", names, off, sizes.x[which], problem.N)
    return sorted(found, key=lambda broken: -broken.share)


def _off(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.maximum(low - values, values - high)


def _worst_entries(
    name: str, components: Sequence[str], off: np.ndarray, size: np.ndarray | float, first: int = 0
) -> list[Broken]:
    """Every component's worst violation of off (S, steps, n), the steps counted from ``first``."""
    amounts = np.maximum(np.nan_to_num(off, nan=0.0), 0.0)
    shares = amounts / size
    found = []
    for i, component in enumerate(components):
        s, k = (int(v) for v in np.unravel_index(int(shares[:, :, i].argmax()), shares.shape[:2]))
        if shares[s, k, i] > 0:
            violation = Violation(name, component, s, k + first, float(amounts[s, k, i]))
            found.append(Broken(violation, float(shares[s, k, i])))
    return found


def _constraints_off(
    problem: Problem, constraints: Sequence[Constraint], x: np.ndarray, u: np.ndarray,
    physical: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Violation of every entry, (S, steps, n), and the size of a change of it."""
    system, sizes = problem.system, problem.sizes
    value = ca.vertcat(*(c.expression for c in constraints))
    low, high = (
        ca.vertcat(*(
            ca.repmat(ca.SX(end), c.expression.numel() // ca.SX(end).numel())
            for end, c in zip(ends, constraints, strict=True)
        ))
        for ends in ([c.lower for c in constraints], [c.upper for c in constraints])
    )  # fmt: skip
    size = _row_sizes(value, system.x, sizes.x) + _row_sizes(value, system.u, sizes.u)
    function = ca.Function(
        "constraints",
        [system.x, system.u, problem.parameters.vector],
        [ca.densify(part) for part in (ca.fmax(low - value, value - high), size)],
    )
    off, size = at_steps(function, x, u, p=physical)
    # Where nothing changes a constraint to first order, any violation of it is a large one.
    return off, np.fmax(size, 1e-12)


def _row_sizes(value: ca.SX, of: ca.SX, sizes: np.ndarray) -> ca.SX:
    """Largest change of every entry by an entry of ``of`` that moves by its size, (n, 1)."""
    J = ca.fabs(ca.densify(ca.jacobian(value, of))) @ ca.diag(ca.DM(sizes))
    return ca.vertcat(*(ca.mmax(ca.horzcat(0, J[i, :])) for i in range(value.numel())))
