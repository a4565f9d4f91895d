"""The examples of CONTRIBUTING.md are short and pass the test that their kind of addition needs."""

from __future__ import annotations

import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import Parameter, ParameterTable, Signal, lcs
from ocp import solve
from ocp.gradients import StaticObjective, estimate_gradient
from ocp.gradients.estimators import SAMPLED
from problems import get, spec
from problems.loading import import_file

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("file", "most"),
    [("bumper.py", 64), ("logistic.py", 50), ("control_variate.py", 40), ("past_a_post.py", 66)],
)
def test_an_addition_is_short(file: str, most: int) -> None:
    assert len((EXAMPLES / file).read_text().splitlines()) <= most


def test_the_problem_solves_is_certified_and_survives() -> None:
    problem = spec(str(EXAMPLES / "bumper.py")).problem()
    found = solve(problem, Exact())
    assert found.success and found.certificate.stationarity == "B" and found.referee.survives
    x, u, lam = (found.data[name].values[0] for name in ("x", "u", "lam"))
    # Brake and wall take the momentum that the mass loses; the brake alone could not.
    assert u.sum() + lam.sum() == pytest.approx(x[-1, 1] + 3.0, abs=1e-9)
    assert lam.sum() > 3 - 20 * 0.1 - 0.1
    assert x[-1] == pytest.approx([0.2, 0], abs=0.02) and x[:, 0].min() >= -1e-9


@pytest.mark.costly
def test_an_object_is_pushed_past_a_post_in_its_way() -> None:
    past = spec(str(EXAMPLES / "past_a_post.py"))
    found = solve(past.problem(), Exact())
    assert found.success and found.certificate.stationarity == "B" and found.referee.survives
    assert found.data["x"].values[0, -1, :2] == pytest.approx([1.0, 0.3], abs=0.02)
    here = found.data.sel(scenario=0, point=["object on post", "pusher on object"])
    push, drag = (np.abs(here[f"{kind}_impulse"]).max("interval") for kind in ("normal", "friction"))
    assert push.min() > 0.1, "the post is in the way"
    assert drag[0] == 0 and drag[1] > 0.01, "the post is smooth, the pusher is not"


def contact(law, compliance: float) -> ca.Function:
    """Return the step ``x+ = lam`` under a law of one contact, whose gap at lam = 0 is the state."""
    one, zero = [[1.0]], [[0.0]]
    p = ParameterTable([Parameter("F", compliance)])
    return law.close(
        lcs(
            "one",
            A=zero,
            B=zero,
            C=one,
            D=one,
            E=zero,
            F=p["F"],
            parameters=p,
            states=(Signal("z", "m"),),
            inputs=(Signal("u", "1"),),
            contacts=(Signal("c", "N s"),),
        )
    ).map


@pytest.mark.parametrize("F", [0.3, 1.0, 20.0])
def test_the_law_tends_to_the_exact_one_and_knows_its_derivative(F: float) -> None:
    Logistic = import_file(EXAMPLES / "logistic.py").Logistic
    exact = np.maximum(0, -(z := np.linspace(-1, 1, 41) + 1e-3)) / F
    for width in (0.3, 1e-2, 1e-5):
        p = [F, width]
        step = contact(Logistic(width), F)
        lam = np.array(step.map(len(z))(z[None], 0, np.tile(p, (len(z), 1)).T)[1]).ravel()
        off = lam - exact
        assert off.min() >= -1e-12 and off.max() <= width * math.log(2) / F + 1e-12
        # The expected slope is the average of -step(-(z + w))/F over logistic noise.
        slope = np.array([slope_of(step, v, p) for v in z])
        expected = -1 / (1 + np.exp(np.clip(z / width, -700, 700))) / F
        np.testing.assert_allclose(slope, expected, atol=1e-10 / F)
        for at in (-0.7 * width, 0.1 * width, 2 * width):
            ahead, behind = (float(step(at + e, 0, p)[1]) for e in (1e-4 * width, -1e-4 * width))
            difference = (ahead - behind) / (2e-4 * width)
            assert slope_of(step, at, p) == pytest.approx(difference, rel=1e-6)


def slope_of(step: ca.Function, z: float, p: list[float]) -> float:
    """Return dlam/dz of the step map at z."""
    return float(step.jacobian()(z, 0, p, *step(z, 0, p))[0])


@pytest.mark.costly
def test_the_law_solves_problems_down_to_the_exact_cost() -> None:
    Logistic = import_file(EXAMPLES / "logistic.py").Logistic
    found = solve(get("wall-1d"), Logistic(1e-4))
    assert found.success and found.certificate.stationarity == "KKT"
    assert found.cost == pytest.approx(solve(get("wall-1d"), Exact()).cost, rel=2e-3)


@pytest.mark.costly
def test_the_estimator_is_unbiased_where_first_order_is_not(monkeypatch) -> None:
    made = import_file(EXAMPLES / "control_variate.py").ControlVariate()
    monkeypatch.setitem(SAMPLED, made.name, made)
    # f = 2 t + t² + 1[t > 0]: grad F = 2 + 2 theta + pdf(theta/sigma)/sigma.
    theta, sigma = 0.2, 0.5
    t = ca.SX.sym("t")
    cost = 2 * t + t**2 + (t > 0)
    objective = StaticObjective("jump", (Signal("t", "1"),), t, cost, [theta], ParameterTable())
    density = math.exp(-((theta / sigma) ** 2) / 2) / (sigma * math.sqrt(2 * math.pi))
    names = [made.name, "zobg-zero-noise", "fobg"]
    found = estimate_gradient(objective, names, 400_000, sigma, reference="none")
    mine, zeroth, first = (found[name] for name in names)
    assert abs(mine.mean[0] - (2 + 2 * theta + density)) <= 4 * mine.standard_error[0]
    assert mine.standard_error[0] < 0.01
    assert first.mean[0] == pytest.approx(2 + 2 * theta, abs=0.01), "blind to the jump"
    assert mine.variance[0] < 0.5 * zeroth.variance[0]
