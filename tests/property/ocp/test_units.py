"""Solutions do not depend on a problem's units of mass, length, time and cost."""

from __future__ import annotations

import functools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.settings import settings_of
from ocp.mpcc import MPCC
from ocp.mpcc import solve as solve_pairs
from ocp.problem.problem import Problem
from ocp.programs.solver import Status
from ocp.programs.units import Units, dimension, fit_units
from ocp.solution import Solution
from ocp.solve.solve import solve
from problems import get, spec
from problems.parameters import is_structural
from tests.examples import settings
from tests.findings import codes, numbers

OTHER = (Units(1e3, 1.0, 1.0), Units(1.0, 1e-3, 1.0), Units(1.0, 1.0, 60.0, 1e-9), Units(1e-3, 1e2, 1e-3, 1e7))
CONSISTENT = (
    "wall-1d",
    "push-1d",
    "push-disc",
    "ball-bounce",
    "box-slide",
    "cart-transport",
    "hopper-1d",
    "planar-push",
)
"""Problems with consistent units of all parameters and cost terms; the cost of hopper-1d is a length."""


CHEAP = (*CONSISTENT, "cart-walls", "ball-throw")
NO_WEIGHTS = {("planar-push", "w_end"), ("hopper-1d", "w_v")}
"""Weights that do not scale with the unit of cost: a ratio of weights, and one next to a length."""


def stated(problem: str, units: Units, **params: float) -> dict[str, float]:
    """Return the parameters in kg, m, s of a problem whose numbers are counted in ``units``."""
    checked = spec(problem).params(params)

    def unit(name: str, one: str) -> float:
        weighs = name.startswith("w_") and (problem, name) not in NO_WEIGHTS
        return units.of(one) * (units.cost if weighs else 1.0)

    return {
        name: getattr(checked, name) * unit(name, about.unit)
        for name, about in settings_of(type(checked)).items()
        if not is_structural(about) or about.unit != "1"
    }


def restated(problem: str, units: Units, **params: float) -> Problem:
    """Return the problem with numbers counted in ``units``; a cost without a weight is scaled as a whole."""
    made = get(problem, **stated(problem, units, **params))
    return dearer(made, units.cost) if problem == "hopper-1d" else made


def dearer(problem: Problem, by: float) -> Problem:
    """Return the problem with all its costs multiplied by a factor."""
    costs = problem.stage_cost, problem.terminal_cost
    return replace(problem, stage_cost=by * costs[0], terminal_cost=by * costs[1])


def cost_unit(problem: str, units: Units) -> float:
    return units.cost * (units.of("m") if problem == "hopper-1d" else 1.0)


@pytest.mark.costly
@pytest.mark.parametrize("problem", CONSISTENT)
def test_costs_are_invariant_under_a_change_of_units(problem: str) -> None:
    known = solve(get(problem), Exact())
    for units in OTHER:
        found = solve(restated(problem, units), Exact())
        size = cost_unit(problem, units)
        assert found.status is known.status is Status.SOLVED
        assert found.cost / size == pytest.approx(known.cost, rel=1e-6)
        x, u = (dimensionless(found, units, key) for key in ("x", "u"))
        if problem != "hopper-1d":
            assert np.abs(x - known.data["x"].values).max() < 1e-5
            assert np.abs(u - known.data["u"].values).max() < 1e-5


@st.composite
def other_units(draw: st.DrawFn) -> Units:
    """Draw units of mass, length and time within a factor of 1000 of SI, and of cost within 1e12."""
    kg, m, s = (10.0 ** draw(st.floats(-3, 3)) for _ in range(3))
    return Units(kg, m, s, 10.0 ** draw(st.floats(-12, 12)))


@functools.cache
def in_si(problem: str, soft: bool, method: str = "direct") -> Solution:
    return solve(get(problem), Barrier(mu=1e-3) if soft else Exact(), method)


def agrees(problem: str, units: Units, soft: bool, method: str = "direct") -> None:
    """Check that status and survival are the same, and costs up to their unit; mu scales with N s m."""
    known = in_si(problem, soft, method)
    law = Barrier(mu=1e-3 * units.of("N s m")) if soft else Exact()
    found = solve(restated(problem, units), law, method)
    size = cost_unit(problem, units)
    assert found.status is known.status is Status.SOLVED
    assert found.cost / size == pytest.approx(known.cost, rel=1e-6)
    assert found.referee.survives == known.referee.survives
    if known.referee.survives:
        assert found.referee.cost / size == pytest.approx(known.referee.cost, rel=1e-3)


@pytest.mark.costly
@settings(max_examples=5)
@given(problem=st.sampled_from(CONSISTENT), units=other_units(), soft=st.booleans())
def test_costs_are_invariant_in_any_units(problem: str, units: Units, soft: bool) -> None:
    agrees(problem, units, soft)


@pytest.mark.slow
@settings(max_examples=150)
@given(problem=st.sampled_from(CONSISTENT), units=other_units(), soft=st.booleans())
def test_costs_are_invariant_in_very_many_units(problem: str, units: Units, soft: bool) -> None:
    agrees(problem, units, soft)


@pytest.mark.slow
@settings(max_examples=60)
@given(
    problem=st.sampled_from(CONSISTENT),
    units=other_units(),
    soft=st.booleans(),
    method=st.sampled_from(["multiple-shooting", "single-shooting"]),
)
def test_shooting_is_invariant_too(problem: str, units: Units, soft: bool, method: str) -> None:
    agrees(problem, units, soft, method)


@pytest.mark.slow
@settings(max_examples=3)
@given(units=other_units())
def test_a_thrown_ball_is_thrown_alike_in_any_units(units: Units) -> None:
    agrees("ball-throw", units, soft=False)


@pytest.mark.costly
@pytest.mark.parametrize("kg", [1e-3, 1e3])
def test_carts_between_walls_move_alike_in_any_unit_of_mass(kg: float) -> None:
    """One weight multiplies all states, so that the cost has no consistent units of length and time."""
    agrees("cart-walls", Units(kg), soft=False)


LAWS: dict[str, ContactLaw] = {
    "exact": Exact(),
    "barrier": Barrier(mu=1e-3),
    "adaptive": Adaptive(sigma=0.02),
    "randomized": Randomized(sigma=0.02),
}


@functools.cache
def in_its_own_cost(problem: str, law: str) -> Solution:
    return solve(get(problem), LAWS[law])


def costs_as_much(problem: str, law: str, cost: float) -> None:
    """Check that a cost in another unit gives the same solution to rounding, as solvers get the same numbers.

    Without a weight in the cost its size is known only to within a band, so that hopper-1d may reach
    the same height by another motion.
    """
    known = in_its_own_cost(problem, law)
    found = solve(restated(problem, Units(cost=cost)), LAWS[law])
    assert found.status is known.status
    assert found.referee.survives == known.referee.survives or problem == "hopper-1d"
    assert found.certificate.stationarity == known.certificate.stationarity
    assert found.cost / cost == pytest.approx(known.cost, rel=1e-6)
    assert found.audit.exact_cost / cost == pytest.approx(known.audit.exact_cost, rel=1e-6)


@pytest.mark.cheap_cases("push-1d-exact-1e-09")
@pytest.mark.parametrize(
    ("problem", "law", "cost"),
    [
        ("push-1d", "exact", 1e-9),
        ("push-1d", "adaptive", 1e-9),
        ("box-slide", "exact", 1e-9),
        ("hopper-1d", "exact", 1e-12),
        ("wall-1d", "randomized", 1e12),
    ],
)
def test_a_cost_in_another_unit_is_the_same_cost(
    problem: str, law: str, cost: float, capfd: pytest.CaptureFixture[str]
) -> None:
    costs_as_much(problem, law, cost)
    assert capfd.readouterr() == ("", ""), "no library prints, whatever the numbers"


@pytest.mark.slow
@settings(max_examples=80)
@given(problem=st.sampled_from(CHEAP), law=st.sampled_from(list(LAWS)), exponent=st.floats(-12, 12))
def test_a_cost_in_any_unit_is_the_same_cost(problem: str, law: str, exponent: float) -> None:
    costs_as_much(problem, law, 10.0**exponent)


@pytest.mark.costly
@pytest.mark.parametrize("problem", ["push-1d", "ball-bounce"])
@pytest.mark.parametrize("method", ["direct", "single-shooting"])
def test_a_power_of_two_of_the_cost_keeps_every_bit(problem: str, method: str) -> None:
    """No parameter reveals the unit, so that the size of the cost itself is measured."""
    known = solve(get(problem), Barrier(mu=1e-3), method)
    found = solve(dearer(get(problem), 2.0**-48), Barrier(mu=1e-3), method)
    assert found.cost == 2.0**-48 * known.cost
    assert np.array_equal(found.data["u"].values, known.data["u"].values)
    assert found.certificate.kkt_residual == known.certificate.kkt_residual
    assert found.certificate.stationarity == known.certificate.stationarity == "KKT"


@pytest.mark.costly
def test_gains_are_held_back_alike_in_any_unit_of_cost() -> None:
    problem = get("push-1d", N=8)
    known = solve(problem, Exact(), policy="feedback")
    found = solve(dearer(problem, 2.0**-48), Exact(), policy="feedback")
    assert np.array_equal(found.data["K"].values, known.data["K"].values)


@pytest.mark.parametrize("cost", [1e-12, 1e-9, 1e9])
def test_a_complementarity_problem_has_a_unit_of_cost_too(cost: float) -> None:
    """It is the leader's problem of the documentation, whose optimum x = 2 costs (1 - 3)²."""
    x, y, s = (ca.SX.sym(name) for name in "xys")
    f = cost * ((x - 2) ** 2 + (y - 3) ** 2)
    problem = MPCC(x=ca.vertcat(x, y, s), f=f, g=y - x + s, G=s, H=1 - y)
    found = solve_pairs(problem)
    assert found.success and found.f / cost == pytest.approx(4.0, rel=1e-6)
    assert found.x == pytest.approx([2, 1, 1], abs=1e-5)


def dimensionless(found: Solution, units: Units, key: str) -> np.ndarray:
    """Return a trajectory counted in ``units``."""
    system = found.problem.system
    signals = system.states if key == "x" else system.inputs
    return found.data[key].values / np.array([units.of(signal.unit) for signal in signals])


@pytest.mark.costly
@pytest.mark.parametrize(
    ("problem", "params", "cost"),
    [
        ("ball-bounce", {"m": 0.01, "u_max": 0.15, "w_u": 100.0}, 0.745009),
        ("push-disc", {"M": 1e6, "K": 5e7}, 0.100678),
    ],
)
def test_light_balls_and_heavy_discs_end_where_others_do(problem: str, params: dict[str, float], cost: float) -> None:
    found = solve(get(problem, **params), Exact())
    assert found.success and found.cost == pytest.approx(cost, rel=1e-5)


def test_a_mu_as_large_as_the_problem_is_told() -> None:
    """A ball of 10 g with mu = 1e-5 is one of 1 kg with mu = 1e-3 in another unit of mass."""
    light = get("ball-bounce", m=0.01, u_max=0.15, w_u=100.0)
    blurred = solve(light, Barrier())
    assert blurred.referee.survives is False
    assert numbers(blurred, "mu-is-large")["mu"] == 0.001
    clear = solve(light, Barrier(mu=1e-5))
    known = in_si("ball-bounce", soft=True)
    assert clear.cost == pytest.approx(known.cost, rel=1e-6)
    assert clear.audit.exact_cost == pytest.approx(known.audit.exact_cost, rel=1e-4)
    assert "mu-is-large" not in codes(clear) and "relies-on-smoothing" in codes(known)


@pytest.mark.cheap_cases("push-1d", "push-disc", "ball-bounce")
@pytest.mark.parametrize("problem", CONSISTENT)
def test_units_are_found_from_the_numbers(problem: str) -> None:
    for units in OTHER:
        params = stated(problem, units)
        found = get(problem, **params).scaling.units
        for unit in ("N s", "m", "m/s", "N"):
            if problem != "planar-push" or unit == "m":
                assert found.of(unit) == pytest.approx(units.of(unit), rel=1e-6)
        assert get(problem).scaling.units == Units()


def test_one_parameter_that_leaves_the_others_is_outvoted() -> None:
    same = [("m", 1.0, False), ("m", 1.0, False), ("s", 1.0, False)]
    lengths = [("m", 50.0), ("m", 2.0), ("m", 2.0), ("m/s", 2.0), ("s", 1.0), ("s", 1.0)]
    found = fit_units([(unit, ratio, False) for unit, ratio in lengths])
    assert found.m == pytest.approx(2.0, rel=1e-9) and found.s == pytest.approx(1.0, abs=1e-9)
    weights = [("1/m^2", 7e-9, True), ("1/m^2", 1e-9, True), ("1", 1e-9, True), *same]
    assert fit_units(weights).cost == pytest.approx(1e-9, rel=1e-9)
    assert fit_units([*weights[:1], ("1", 1.0, True), *same]).cost == 1.0


@pytest.mark.parametrize(
    ("unit", "exponents"),
    [
        ("1/(N s)^2", (-2, -2, 2)),
        ("1/(N^2 s)", (-2, -2, 3)),
        ("N m s/rad", (1, 2, -1)),
        ("kg m²", (1, 2, 0)),
        ("s^2/m", (0, -1, 2)),
        ("1", (0, 0, 0)),
    ],
)
def test_units_are_read(unit: str, exponents: tuple[int, int, int]) -> None:
    read = dimension(unit)
    assert read is not None and read.tolist() == list(exponents)
    assert dimension("SI") is None
