"""Feasible but arbitrary points are never reported as solved, even if a solver claims it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from ocp import Direct, MultipleShooting, OpenLoop, Problem, SingleShooting, Status
from ocp.problem.rollout import Rollout, roll_out
from ocp.programs.solver import Point, Result
from ocp.routes.homotopy import RouteResult, Trace
from ocp.routes.rollouts import pack_rollout
from ocp.routes.session import Session
from ocp.solve.judging import judge_outcome
from problems import get

NAMES = (
    "wall-1d",
    "push-1d",
    "push-disc",
    "ball-bounce",
    "cart-walls",
    "box-slide",
    "ball-throw",
    "cart-transport",
    "hopper-1d",
    "planar-push",
    "planar-hand",
)
MACHINES = ("hopper", "half-cheetah")
LAWS: dict[str, ContactLaw] = {
    "exact": Exact(),
    "barrier": Barrier(mu=1e-3),
    "adaptive": Adaptive(sigma=0.02),
    "quartic": Adaptive(law="quartic", mu_max=1e-3),
    "randomized": Randomized(sigma=0.05, samples=2, base=Barrier(mu=1e-3)),
}


def without_constraints(name: str) -> Problem:
    """Return the problem with bounds on its inputs alone, so that every rollout is feasible."""
    problem = get(name)
    return replace(problem, path=(), terminal=(), start=None, x_lower=-ca.inf, x_upper=ca.inf)


def perturbed(session: Session, seed: int) -> Rollout:
    """Return a rollout of random inputs about the guess, under the session's law."""
    problem, values = session.problem, session.values
    physical = problem.parameters.pack(values)
    _, U = problem.initial_guess(physical)
    lower, upper = (np.array(v).ravel() for v in problem.limits(physical)[2:4])
    noise = np.random.default_rng(seed).standard_normal(U.shape)
    inputs = np.clip(U + 0.1 * problem.scaling.u * noise, lower, upper)
    return roll_out(problem, inputs[None], values, session.step)


def claimed(session: Session, x: np.ndarray, reformulation: str = "product") -> RouteResult:
    """Return the result of a solver that stopped at ``x`` and reported it as optimal."""
    nlp = session.nlp_of(reformulation)
    f, g = nlp.f_g(x, nlp.parameter_vector(session.values))
    result = Result(Point(x), float(f), np.array(g).ravel(), Status.SOLVED, "claimed", 1, 0.0)
    return RouteResult(result, nlp, True, Trace())


def status_of_random_inputs(name: str, law: str, seed: int = 0) -> Status:
    session = Session(without_constraints(name), LAWS[law], Direct(), OpenLoop())
    reformulation = "none" if session.step.exact else "product"
    x = pack_rollout(session.nlp_of(reformulation), perturbed(session, seed), None)
    found = judge_outcome(session, claimed(session, x, reformulation), seed=0)
    assert found.audit.dynamics_residual < 1e-8, "the point is feasible"
    return found.status


@pytest.mark.one_case_in(28)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_random_inputs_are_not_optimal(name: str, law: str) -> None:
    assert status_of_random_inputs(name, law) in (Status.NOT_OPTIMAL, Status.NO_PROGRESS)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["exact", "barrier"])
@pytest.mark.parametrize("name", MACHINES)
def test_random_inputs_of_a_machine_are_not_optimal(name: str, law: str) -> None:
    assert status_of_random_inputs(name, law) in (Status.NOT_OPTIMAL, Status.NO_PROGRESS)


@pytest.mark.cheap_cases("1-barrier-method1", "2-exact-method1", "2-barrier-method1")
@pytest.mark.parametrize("method", [SingleShooting(), MultipleShooting()])
@pytest.mark.parametrize("law", ["exact", "barrier"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_in_shooting_too(method, law: str, seed: int) -> None:
    """push-1d at random inputs was once reported as solved at 4.2, three times its optimum."""
    session = Session(without_constraints("push-1d"), LAWS[law], method, OpenLoop())
    rolled = perturbed(session, seed)
    nlp = session.nlp_of("product")
    blocks = {"x": rolled.x[:, 1:], "u": rolled.u}
    x = nlp.variables.pack({k: v for k, v in blocks.items() if k in nlp.variables})
    found = judge_outcome(session, claimed(session, x), seed=0)
    assert found.status in (Status.NOT_OPTIMAL, Status.NO_PROGRESS)
    assert found.certificate.stationarity == "not"
    assert not found.success
