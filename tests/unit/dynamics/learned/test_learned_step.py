"""A model that is no CasADi graph, as the step of programs, rollouts and solves."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import RolloutFunction, open_loop
from dynamics.contact import ContactLaw, Exact, Randomized
from dynamics.contact.learned_step import CasadiMap
from dynamics.learned.laws import Ewda, Mlp
from ocp import Direct, Feedback, MultipleShooting, OpenLoop, SingleShooting, solve
from ocp.problem.rollout import roll_out
from ocp.programs.program import PENALTY, RELAXATION
from ocp.transcription.common import Graph
from problems import get
from tests.findings import numbers
from tests.unit.dynamics.learned.wavy import Wavy

PROBLEM = get("planar-push", N=4)
LAWS = {
    "ewda": lambda: Ewda(Wavy(PROBLEM.system)),
    "trusting": lambda: Ewda(Wavy(PROBLEM.system), trust=0.3),
    "averaged": lambda: Randomized(sigma=0.1, samples=4, base=Ewda(Wavy(PROBLEM.system), 0.3)),
}
METHODS = (Direct(), MultipleShooting(), SingleShooting())


def differences(function, x: np.ndarray, e: float = 1e-6) -> np.ndarray:
    rows = [(function(x + e * d) - function(x - e * d)) / (2 * e) for d in np.eye(x.size)]
    return np.array(rows)


@pytest.mark.one_case_in(9)
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("policy", [OpenLoop(), Feedback()], ids=lambda p: p.name)
def test_first_and_second_derivatives_are_those_of_differences(law, method, policy):
    step = LAWS[law]().close(PROBLEM.system)
    nlp = method.transcribe(Graph(PROBLEM, step, policy))
    values = (PROBLEM.parameters + step.p).defaults | {PENALTY: 0.0, RELAXATION: 0.0}
    p = nlp.parameter_vector(values)
    rng = np.random.default_rng(0)
    x, lam_g = 0.3 * rng.standard_normal(nlp.n), rng.standard_normal(nlp.m)

    def f_g(z: np.ndarray) -> np.ndarray:
        return np.concatenate([np.array(part).ravel() for part in nlp.f_g(z, p)])

    def slope(z: np.ndarray) -> np.ndarray:
        jacobian = np.array(ca.DM(nlp.jacobian(z, p)[1]))
        return 1.3 * np.array(nlp.gradient(z, p)[1]).ravel() + jacobian.T @ lam_g

    first = np.vstack([np.array(nlp.gradient(x, p)[1]).reshape(1, -1), np.array(ca.DM(nlp.jacobian(x, p)[1]))])
    expected = differences(f_g, x).T
    assert np.allclose(first, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
    upper = np.triu(np.array(ca.DM(nlp.hessian(x, p, 1.3, lam_g))))
    second = upper + np.triu(upper, 1).T
    expected = differences(slope, x)
    assert np.allclose(second, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def test_trust_adds_the_weighted_density_to_the_stage_cost():
    """The cost with trust less the cost without it is ``-beta sum_k log p(x_k, u_k)``."""
    x = 0.3 * np.random.default_rng(1).standard_normal(PROBLEM.N * 7)
    found = {}
    for name in ("ewda", "trusting"):
        step = LAWS[name]().close(PROBLEM.system)
        nlp = Direct().transcribe(Graph(PROBLEM, step, OpenLoop()))
        values = (PROBLEM.parameters + step.p).defaults | {PENALTY: 0.0, RELAXATION: 0.0}
        p = nlp.parameter_vector(values)
        found[name] = float(nlp.f_g(x, p)[0])
    blocks = nlp.variables.unpack(x)
    start = PROBLEM.initial_states(PROBLEM.parameters.values)
    states = np.concatenate([start, blocks["x"][0, :-1]])
    log_p = Wavy(PROBLEM.system).values(np.hstack([states, blocks["u"][0]]))[:, -1]
    assert found["trusting"] - found["ewda"] == pytest.approx(-0.3 * log_p.sum(), rel=1e-12)


@pytest.mark.costly
def test_methods_agree_and_the_plan_is_replayed_under_the_exact_law():
    costs = []
    for method in METHODS:
        answer = solve(PROBLEM, contact=Ewda(Wavy(PROBLEM.system)), method=method)
        assert answer.success
        again = roll_out(PROBLEM, answer.data["u"].values, answer.values, Exact())
        assert answer.audit.exact_cost == pytest.approx(again.cost)
        assert answer.data["lam"].size == 0
        assert np.isnan(answer.data["normal_impulse"]).all()
        costs.append(answer.cost)
    assert costs == pytest.approx([costs[0]] * 3, rel=1e-8)


@pytest.mark.costly_cases("casadi-averaged")
@pytest.mark.parametrize("law", ["ewda", "averaged"])
@pytest.mark.parametrize("backend", ["auto", "casadi"])
def test_rollouts_cost_and_gradient(law, backend):
    step = LAWS[law]().close(PROBLEM.system)
    s, p, N = PROBLEM.system, step.p.vector, PROBLEM.N
    stage = ca.Function("stage", [s.x, s.u, PROBLEM.du, p], [PROBLEM.stage_cost])
    end = ca.Function("end", [s.x, p], [PROBLEM.terminal_cost])
    rolled = RolloutFunction(step, stage, end, N, open_loop(s.nx, s.nu), backend=backend)
    values = (PROBLEM.parameters + step.p).defaults
    physical = PROBLEM.parameters.values
    given = {"u_before": np.array(PROBLEM.limits(physical)[1]).ravel()}
    start = PROBLEM.initial_states(physical)[0]
    theta = 0.2 * np.random.default_rng(0).standard_normal((3, N, s.nu))
    found = rolled(start, theta, **given)
    costs = [roll_out(PROBLEM, one[None], values, step).cost for one in theta]
    assert found.cost == pytest.approx(costs, rel=1e-12)

    def cost(flat: np.ndarray) -> np.ndarray:
        return rolled(start, flat.reshape(1, N, s.nu), **given, gradient=False).cost

    for one, gradient in zip(theta, found.gradient, strict=True):
        expected = differences(cost, one.ravel()).ravel()
        assert gradient.ravel() == pytest.approx(expected, rel=1e-6, abs=1e-5)


@pytest.mark.costly
def test_rollouts_do_not_depend_on_threads():
    step = LAWS["ewda"]().close(PROBLEM.system)
    s, p = PROBLEM.system, step.p.vector
    stage = ca.Function("stage", [s.x, s.u, p], [ca.sumsqr(s.x) + ca.sumsqr(s.u)])
    end = ca.Function("end", [s.x, p], [ca.sumsqr(s.x)])
    theta = 0.1 * np.random.default_rng(0).standard_normal((40_000, 2, s.nu))
    one, two = (
        RolloutFunction(step, stage, end, 2, open_loop(s.nx, s.nu), threads=n)(np.zeros(5), theta) for n in (1, 2)
    )
    assert np.array_equal(one.cost, two.cost)
    assert np.array_equal(one.gradient, two.gradient)


def test_the_model_as_a_function_that_casadi_differentiates_twice():
    model = Wavy(PROBLEM.system)
    z, value = ca.MX.sym("z", model.n_in), CasadiMap(model).values()
    jacobian = ca.Function("J", [z], [ca.jacobian(value(z), z)])
    weights = np.random.default_rng(2).standard_normal(model.n_out)
    hessian = ca.Function("H", [z], [ca.hessian(ca.dot(weights, value(z)), z)[0]])
    at = np.random.default_rng(3).standard_normal(model.n_in)
    assert np.allclose(np.array(jacobian(at)), model.jacobians(at[None])[1][0], rtol=1e-13)
    assert np.allclose(np.array(hessian(at)), model.curvatures(at[None], weights[None])[0], rtol=1e-12)


def test_a_point_is_evaluated_once():
    model = Wavy(PROBLEM.system)
    step = Ewda(model).close(PROBLEM.system)
    nlp = Direct().transcribe(Graph(PROBLEM, step, OpenLoop()))
    values = (PROBLEM.parameters + step.p).defaults | {PENALTY: 0.0, RELAXATION: 0.0}
    p, x = nlp.parameter_vector(values), np.zeros(nlp.n)
    nlp.f_g(x, p), nlp.gradient(x, p), nlp.jacobian(x, p)
    nlp.hessian(x, p, 1.0, np.zeros(nlp.m))
    # Two of the four queries at zero are the same, x_0 = 0 being no start of this problem.
    assert model.asked <= PROBLEM.N


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Ewda(), "needs its model"),
        (lambda: Ewda("nowhere.nc"), "file not found"),
        (lambda: Mlp(Wavy(PROBLEM.system)), "kind ewda; use --contact ewda"),
        (lambda: Ewda(Wavy(PROBLEM.system), trust=-1.0), "trust must be a number >= 0"),
        (lambda: Ewda(Wavy(get("push-disc").system)).close(PROBLEM.system), "was trained on"),
    ],
)
def test_what_a_learned_law_refuses(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_settings_make_the_same_law_again():
    law: ContactLaw = Ewda(Wavy(PROBLEM.system), trust=0.2)
    assert law.at(trust=0.5).settings()["trust"] == 0.5
    assert law.settings() == {"model": "wavy", "trust": 0.2}


def test_a_verdict_says_where_the_data_were_taken_at_other_parameters():
    """Only parameters of the motion count; weights of the cost may differ."""
    model = Wavy(PROBLEM.system)
    told = {"friction": 0.5, "m": 5.0, "w_du": 1.0}
    model.origin = replace(model.origin, parameters=told)
    answer = solve(PROBLEM, contact=Ewda(model))
    assert numbers(answer, "training-data-differ") == {"differences": "friction = 0.5, not 0.666667"}
    assert answer.record["learned_at"] == {"friction": (0.5, 2 / 3)}
