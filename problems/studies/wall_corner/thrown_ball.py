"""A ball thrown at a wall with a flat top or with a dome on it: elastic, with sub-step impacts."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, Gaussian
from dynamics.systems import Signal
from ocp.gradients.objective import SampledObjective, Samples


@dataclass(frozen=True)
class Wall:
    """A wall of ``width`` and ``height`` [m] around x = ``place``; half a disc on it, or not."""

    place: float
    width: float
    height: float
    dome: bool


def flight_step(wall: Wall, g: float, h: float) -> ca.Function:
    """One step of (x, y, vx, vy), with a mirror reflection within it where the ball meets the wall.

    ``v+ = v - g h``, then along the straight way ``h v+`` up to the first impact at the fraction s
    of it, ``v+ <- v+ - 2 (v+·n) n``, and on for (1 - s) h. The normal n is (-1, 0) at the face,
    (0, 1) on a flat top, radial on the dome.
    """
    state = ca.SX.sym("state", 4)
    v = state[2:] - ca.DM([0, g * h])
    p, way = state[:2], h * v
    left, right = wall.place - wall.width / 2, wall.place + wall.width / 2
    face = _fraction(left - p[0], way[0])
    at_face = p + face * way
    hits_face = ca.logic_and(ca.logic_and(p[0] < left, p[0] + way[0] >= left),
                             at_face[1] < wall.height)  # fmt: skip
    if wall.dome:
        centre, radius = ca.DM([wall.place, wall.height]), wall.width / 2
        off = p - centre
        a, b = ca.sumsqr(way), ca.dot(off, way)
        outside = ca.sumsqr(off) - radius**2
        discriminant = b * b - a * outside
        meets = ca.logic_and(ca.logic_and(discriminant > 0, b < 0), outside > 0)
        over = (-b - ca.sqrt(ca.if_else(meets, discriminant, 1.0))) / a
        normal = (off + over * way) / radius
        hits_top = ca.logic_and(ca.logic_and(meets, over <= 1), (off + over * way)[1] >= 0)
    else:
        over = _fraction(wall.height - p[1], way[1])
        at_top = p + over * way
        falls = ca.logic_and(p[1] >= wall.height, p[1] + way[1] < wall.height)
        between = ca.logic_and(at_top[0] >= left, at_top[0] <= right)
        hits_top = ca.logic_and(falls, between)
        normal = ca.SX(ca.DM([0, 1]))
    hits = ca.logic_or(hits_face, hits_top)
    s = ca.if_else(hits_face, face, ca.if_else(hits_top, over, 1.0))
    n = ca.if_else(hits_face, ca.SX(ca.DM([-1, 0])), normal)
    mirrored = ca.if_else(hits, v - 2 * ca.dot(v, n) * n, v)
    landed = p + s * way + (1 - s) * h * mirrored
    return ca.Function("flight", [state], [ca.vertcat(landed, mirrored)])


def _fraction(distance: ca.SX, way: ca.SX) -> ca.SX:
    """``distance/way``, harmless where there is no way."""
    still = ca.fabs(way) < 1e-12
    return distance / ca.if_else(still, 1.0, way)


class ThrownBall(SampledObjective):
    """Minus the distance x [m] after ``steps``, of a ball thrown from the origin at angle theta.

    Gradients are those of the steps, carried forward with the state.
    """

    def __init__(self, wall: Wall, v0: float, g: float, h: float, steps: int) -> None:
        self.name = "dome" if wall.dome else "rectangle"
        self.decision = (Signal("theta", "rad", "angle of the throw"),)
        self.theta, self.n_noise, self.parameters = np.zeros(1), 1, {}
        self._v0, self._steps = v0, steps
        step = flight_step(wall, g, h)
        state, tangent = ca.SX.sym("state", 4), ca.SX.sym("tangent", 4)
        after = step(state)
        moved = ca.jtimes(after, state, tangent)
        self._move = BatchFunction(ca.Function("move", [state], [after]))
        self._both = BatchFunction(ca.Function("both", [state, tangent], [after, moved]))

    def paths(self, theta: np.ndarray) -> np.ndarray:
        """Positions (n, steps + 1, 2) of throws at ``theta`` (n,)."""
        state = self._start(theta)[0]
        found = [state[:, :2]]
        for _ in range(self._steps):
            state = self._move(state)
            found.append(state[:, :2])
        return np.stack(found, axis=1)

    def costs(self, noise: np.ndarray) -> np.ndarray:
        """Minus the final x at theta + noise."""
        state = self._start(self.theta + noise[:, 0])[0]
        for _ in range(self._steps):
            state = self._move(state)
        return -state[:, 0]

    def scored(self, noise: Gaussian, n: int) -> Samples:
        """Costs, and w / sigma²."""
        w = noise.draw(n, 1, 1)[:, 0]
        return Samples(self.costs(w), w / noise.scales(1) ** 2)

    def differentiated(self, noise: Gaussian, n: int) -> Samples:
        """Costs, and derivatives through every impact."""
        state, tangent = self._start(self.theta + noise.draw(n, 1, 1)[:, 0, 0])
        for _ in range(self._steps):
            state, tangent = self._both(state, tangent)
        return Samples(-state[:, 0], -tangent[:, :1])

    def _start(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State and its derivative by theta at the throw, (n, 4) each."""
        angle = np.ravel(theta)
        zero = np.zeros_like(angle)
        along, across = self._v0 * np.cos(angle), self._v0 * np.sin(angle)
        return (np.stack((zero, zero, along, across), 1), np.stack((zero, zero, -across, along), 1))
