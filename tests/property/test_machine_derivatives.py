"""First-order gradients through hopper and half-cheetah agree with central differences."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, ContactLaw, Exact, Step
from problems.bodies.simulation import simulate, simulation

LAWS: dict[str, ContactLaw] = {"exact": Exact(), "barrier": Barrier(mu=1e-3)}
MACHINES: dict[str, dict[str, Any]] = {"hopper": {}, "half-cheetah": {"spheres": "feet"}}
# Steps after the reset: in the air, just before landing, just landed, and slower on the ground.
MOMENTS = [0, 3, 5, 12]
STEPS = 10
CASES = [
    ("hopper", "exact"),
    ("hopper", "barrier"),
    ("half-cheetah", "barrier"),
    pytest.param("half-cheetah", "exact", marks=pytest.mark.slow),
]


@dataclass(frozen=True)
class Case:
    """A closed step, its parameters, states of a fall (steps + 1, nx) and nonzero inputs."""

    step: Step
    p: np.ndarray
    x: np.ndarray
    u: np.ndarray


@cache
def fall(name: str) -> np.ndarray:
    return simulate(name, max(MOMENTS), seed=2, **MACHINES[name]).x[0]


@cache
def case(name: str, law: str) -> Case:
    problem, _ = simulation(name, seed=2, **MACHINES[name])
    step = LAWS[law].close(problem.system)
    u = np.random.default_rng(1).uniform(-0.1, 0.1, (STEPS, problem.system.nu))
    return Case(step, step.p.values, fall(name), u)


def difference(function, w: np.ndarray, along: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Return the central difference of a vector function along a direction."""
    return (function(w + step * along) - function(w - step * along)) / (2 * step)


@pytest.mark.costly
@pytest.mark.parametrize(("name", "law"), CASES)
def test_steps(name: str, law: str):
    """All columns of the Jacobian of one step by state and input agree."""
    found = case(name, law)
    step, nx = found.step, found.step.system.nx
    jacobian = step.map.jacobian()
    nc = sum(pair.kind == "normal" for pair in step.system.pairs)
    forces = []

    def after(w: np.ndarray) -> np.ndarray:
        return np.array(step.map(w[:nx], w[nx:], found.p)[0]).ravel()

    for k in MOMENTS:
        x, u = found.x[k], found.u[0]
        x_next, lam = step.map(x, u, found.p)
        got = np.hstack([np.array(J) for J in jacobian(x, u, found.p, x_next, lam)[:2]])
        w = np.concatenate([x, u])
        wanted = np.stack([difference(after, w, e) for e in np.eye(len(w))], axis=1)
        assert np.allclose(got, wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max()), k
        forces.append(float(ca.mmax(lam[:nc])))
    assert forces[-1] > 0.1 > forces[0]


@pytest.mark.costly
@pytest.mark.parametrize(("name", "law"), CASES)
def test_rollouts(name: str, law: str):
    """The gradient by the inputs of a cost after ten steps agrees, through the landing."""
    found = case(name, law)
    step = found.step
    inputs = ca.MX.sym("u", step.system.nu, STEPS)
    x = ca.MX(found.x[2])
    for k in range(STEPS):
        x = step.map(x, inputs[:, k], found.p)[0]
    cost = x[0] + 0.1 * ca.sumsqr(x)
    both = ca.Function("fobg", [inputs], [cost, ca.gradient(cost, inputs)])
    gradient = np.array(both(found.u.T)[1])
    rng = np.random.default_rng(3)
    for _ in range(3):
        along = rng.standard_normal(gradient.shape)
        slope = difference(lambda u: np.array(both(u)[0]).ravel(), found.u.T, along, 1e-6)
        assert np.sum(gradient * along) == pytest.approx(slope[0], rel=1e-5)
