"""One time step with Coulomb friction by enumeration of the modes of all contacts, without a path or barrier.

Each contact is open, sticks, slides forward or slides backward. With linearised gaps each choice of
modes gives linear equations; the solution is the choice that satisfies the inequalities. Curved gaps
are linearised again at the end of the step until it no longer changes (Josephy-Newton).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.systems import Machine
from dynamics.systems.planar.flight import gyroscopic_impulse

OPEN, STICK, FORWARD, BACKWARD = range(4)
_FAR = 0.3


@dataclass(frozen=True)
class Landed:
    """End of a step: q and v (nq,), normal and tangential impulses (contacts,) [N s]."""

    q: np.ndarray
    v: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray


class ModeStepper:
    """Steps of a machine on the ground, from the equations of motion of its chain.

    Velocity forces are explicit unless ``implicit``, as in simulations.
    """

    def __init__(self, machine: Machine, h: float, friction: float, *, implicit: bool = False) -> None:
        self.h, self.friction, self.nq = h, friction, machine.tree().nq
        chain = machine.tree()
        q, v = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq)
        centres = [chain.position(q, s.link, s.centre) for s in machine.spheres]
        gaps = ca.vertcat(*(c[1] - s.radius for c, s in zip(centres, machine.spheres, strict=True)))
        # For rolling, the velocity of a disc's lowest point is that of its centre less its rotation.
        turning = [chain.pose(q, s.link).angle for s in machine.spheres]
        slide = ca.vertcat(
            *(
                ca.jacobian(c[0], q) - s.radius * ca.jacobian(a, q)
                for c, s, a in zip(centres, machine.spheres, turning, strict=True)
            )
        )
        D, K = -ca.jacobian(chain.damping(v), v), -ca.jacobian(chain.spring(v), v)
        drive = chain.mass(q) @ v - h * (chain.bias(q, v) + K @ q)
        if implicit:
            drive += h * (chain.bias(q, v) - chain.weight(q)) + gyroscopic_impulse(chain, q, v, h)
        inertia = chain.mass(q) + h * D + h * h * K
        self.motion = ca.Function("motion", [q, v], [ca.densify(inertia), drive])
        self.contact = ca.Function("contact", [q], [gaps, ca.densify(ca.jacobian(gaps, q))])
        self.sliding = ca.Function("sliding", [q], [ca.densify(slide)])
        self.gears = np.array(ca.DM(chain.B))
        self.modes = np.array(list(itertools.product(range(4), repeat=len(machine.spheres))))

    def step(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> Landed:
        """Return the end of one step; raise ``AssertionError`` if no choice of modes is consistent."""
        inertia, drive = (np.array(part) for part in self.motion(q, v))
        free = np.linalg.solve(inertia, drive.ravel() + self.h * self.gears @ u)
        push = np.array(self.contact(q)[1])
        rub = np.array(self.sliding(q))
        by_impulse = np.linalg.solve(inertia, np.vstack([push, rub]).T)
        there, moved = q, np.inf
        for _ in range(30):
            gap, slope = (np.array(part) for part in self.contact(there))
            here = gap.ravel() - slope @ (there - q)
            normal, tangential = self._modes(here, slope, rub, free, by_impulse)
            v_next = free + by_impulse @ np.concatenate([normal, tangential])
            moved, there = np.abs(q + self.h * v_next - there).max(), q + self.h * v_next
            if moved < 1e-13:
                return Landed(there, v_next, normal, tangential)
        raise AssertionError(f"curved gaps: the step still moves by {moved:.1e}")

    def _modes(
        self,
        gap: np.ndarray,
        slope: np.ndarray,
        rub: np.ndarray,
        free: np.ndarray,
        by_impulse: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the impulses of the modes that satisfy gaps ``gap + slope h v``, slips ``rub v`` and cones best."""
        n, f = len(gap), self.friction
        # Contacts this far off stay open; if they did not, the inequalities below would fail.
        far = gap + self.h * slope @ free > _FAR
        modes = self.modes[np.all((self.modes == OPEN) | ~far, axis=1)]
        closed = modes != OPEN
        stick = modes == STICK
        sign = np.where(modes == FORWARD, -1.0, np.where(modes == BACKWARD, 1.0, 0.0))
        rate = np.vstack([self.h * slope, rub])
        W, start = rate @ by_impulse, np.concatenate([gap, np.zeros(n)]) + rate @ free
        keep = np.concatenate([closed, stick], axis=1)[:, :, None]
        other = np.zeros((len(modes), 2 * n, 2 * n))
        i = np.arange(n)
        other[:, i, i] = other[:, n + i, n + i] = 1.0
        other[:, n + i, i] = -sign * f
        equations = np.where(keep, W, other)
        impulse = _solve(equations, np.where(keep[:, :, 0], -start, 0.0))
        ends = start + impulse @ W.T
        normal, tangential = impulse[:, :n], impulse[:, n:]
        wrong = np.concatenate(
            [
                -normal,
                -ends[:, :n],
                np.abs(tangential) - f * normal,
                np.where(closed, sign * ends[:, n:], 0.0),
                np.where(closed, np.abs(ends[:, :n]), 0.0),
                np.where(stick, np.abs(ends[:, n:]), 0.0),
            ],
            axis=1,
        ).max(axis=1)
        best = int(np.argmin(wrong))
        assert wrong[best] < 1e-9, f"no modes fit: {wrong[best]:.1e}"
        return normal[best], tangential[best]


def _solve(equations: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return solutions of minimum norm, since two contacts of one rigid foot can share a force in many ways."""
    singular = np.linalg.cond(equations) > 1e12
    found = np.zeros_like(right)
    found[~singular] = np.linalg.solve(equations[~singular], right[~singular][..., None])[..., 0]
    for k in np.flatnonzero(singular):
        found[k] = np.linalg.lstsq(equations[k], right[k], rcond=1e-12)[0]
    return found
