"""Small problems that use every feature of a transcription, and numerical derivatives."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from ocp import (
    Constraint,
    Direct,
    Feedback,
    MultipleShooting,
    OpenLoop,
    Problem,
    Scenarios,
    SingleShooting,
)
from ocp.problem.policy import Policy
from ocp.routes.session import Session
from ocp.transcription import Method
from problems import get

METHODS: dict[str, Method] = {method.name: method for method in (Direct(), MultipleShooting(), SingleShooting())}
FIVE = ("wall-1d", "push-1d", "push-disc", "ball-bounce", "cart-walls")
SMOOTH = 0.05


def crowded(scenarios: int = 1, N: int = 4) -> Problem:
    """Return a disc to push, with bounds on x and u, path and terminal constraints, and costs on du."""
    problem = get("push-disc", N=N)
    x, u = problem.system.x, problem.system.u
    apart = ca.sumsqr(x[:2] - x[2:]) + 0.1 * ca.sumsqr(u)
    return replace(
        problem,
        x_lower=-4.0,
        x_upper=4.0,
        path=(Constraint("apart", apart, 0.2, 9.0), Constraint("swing", ca.sin(u) * x[0], -1, 1)),
        terminal=(Constraint("rest", ca.vertcat(x[0] * x[1], ca.exp(x[2])), -1.0, 2.0),),
        scenarios=Scenarios(scenarios, (0.05, 0.05, 0.01, 0.0), 3),
    )


def two_walls(scenarios: int = 1, N: int = 4) -> Problem:
    """Return a problem of two coupled contacts without a cost on du, bounded in u only, near the right wall."""
    problem = get("cart-walls", N=N, p0=0.2, theta0=0.25)
    return replace(problem, scenarios=Scenarios(scenarios, (0.02, 0.02, 0.0, 0.1), 5))


def line(N: int = 4) -> Problem:
    """Return a push along a line that starts in contact, where one step's impulse is piecewise linear."""
    return get("push-1d", N=N, qa0=-0.2)


def weighed(problem: Problem) -> Problem:
    """Return ``problem`` with a cost on the square of contact impulses and a bound on their sum."""
    lam = problem.system.lam
    limit = Constraint("press", ca.sum1(lam) + problem.system.u[0], -9.0, 9.0)
    return replace(problem, stage_cost=problem.stage_cost + ca.sumsqr(lam), path=[limit])


Case = tuple[Callable[[], Problem], Callable[[], ContactLaw], Policy]
CASES: dict[str, Case] = {
    "open-loop": (crowded, lambda: Barrier(mu=SMOOTH), OpenLoop()),
    "scenarios": (lambda: crowded(3), lambda: Barrier(mu=SMOOTH), OpenLoop()),
    "feedback": (lambda: crowded(3), lambda: Barrier(mu=SMOOTH), Feedback(penalty=0.1)),
    "stationary": (lambda: crowded(2), lambda: Barrier(mu=SMOOTH), Feedback(0.1, stationary=True)),
    "adaptive": (lambda: crowded(2), lambda: Adaptive(sigma=0.4), OpenLoop()),
    "two-contacts": (lambda: two_walls(2), lambda: Barrier(mu=SMOOTH), OpenLoop()),
    "two-feedback": (lambda: two_walls(2), lambda: Barrier(mu=SMOOTH), Feedback(penalty=0.1)),
    "randomized": (line, lambda: Randomized(0.2, 3, scheme="gauss-hermite", base=Barrier(mu=SMOOTH)), OpenLoop()),
    "impulses": (lambda: weighed(two_walls(2)), lambda: Barrier(mu=SMOOTH), OpenLoop()),
    "mean-impulses": (
        lambda: weighed(line()),
        lambda: Randomized(0.2, 3, scheme="gauss-hermite", base=Barrier(mu=SMOOTH)),
        Feedback(penalty=0.1),
    ),
    "exact": (lambda: two_walls(2), Exact, Feedback(penalty=0.1)),
}


@functools.cache
def session(case: str, method: str) -> Session:
    problem, law, policy = CASES[case]
    return Session(problem(), law(), METHODS[method], policy)


def point(found: Session, seed: int, spread: float, reformulation: str = "product") -> np.ndarray:
    """Return random variables around the problem's own guess, where every geometry is well defined."""
    nlp = found.nlp_of(reformulation)
    noise = np.random.default_rng(seed).standard_normal(nlp.n)
    return found.first_point(nlp).x + spread * noise


def directions(n: int, seed: int, most: int = 16) -> np.ndarray:
    """Return unit vectors (n, d) to differentiate along: all axes, or ``most`` random directions if n is larger."""
    if n <= most:
        return np.eye(n)
    drawn = np.random.default_rng(seed).standard_normal((n, most))
    return drawn / np.linalg.norm(drawn, axis=0)


def numerical(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return derivatives (outputs, d) by the five-point stencil, whose error is of order h^4."""
    step = 3e-4
    columns = []
    for unit in along.T:
        near = function(x + step * unit) - function(x - step * unit)
        far = function(x + 2 * step * unit) - function(x - 2 * step * unit)
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


def full(value: object) -> np.ndarray:
    """Return a CasADi matrix, sparse or dense, as an array."""
    return value if isinstance(value, np.ndarray) else np.array(ca.densify(ca.DM(value)))


def off(found: object, expected: object) -> float:
    """Return the largest difference, relative to the largest expected entry or 1."""
    left, right = full(found), full(expected)
    difference = left.ravel() - right.ravel()
    return float(np.abs(difference).max(initial=0.0) / max(1.0, np.abs(right).max(initial=0.0)))


def upper_to_full(triangle: ca.DM) -> np.ndarray:
    """Return the symmetric matrix with the given upper triangle."""
    upper = full(triangle)
    return np.triu(upper) + np.triu(upper, 1).T
