"""Systems: errors of their builders, their affine form, and their linearisation."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.contact import Barrier, Exact
from dynamics.systems import (
    ContactSystem,
    Parameter,
    ParameterTable,
    Signal,
    is_p_matrix,
    lcs,
    quasi_dynamic,
    signals,
    time_stepping,
)
from dynamics.systems.checks import require_limits


def stepping(**changes):
    arguments = {
        "states": signals("x [m]; v [m/s]"),
        "inputs": signals("u [N s]"),
        "contacts": signals("wall [N s]"),
        "h": 0.1,
        "mass": ca.SX(1),
        "impulse": lambda q, v, u: u,
        "distance": lambda q: q,
        "parameters": ParameterTable(),
    }
    return time_stepping("wall", **{**arguments, **changes})


def pushing(**changes):
    arguments = {
        "states": signals("a [m]; b [m]"),
        "inputs": signals("u [m]"),
        "contacts": signals("push [N s]"),
        "h": 0.1,
        "mass": ca.SX(1),
        "stiffness": ca.SX(100),
        "distance": lambda q: q[0] - q[1],
        "parameters": ParameterTable(),
    }
    return quasi_dynamic("push", **{**arguments, **changes})


def matrices(**changes):
    one = np.ones((1, 1))
    return lcs("lcs", **{**dict.fromkeys("ABCDEF", one), **changes})


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: stepping(states=signals("x [m]")), "1 states; expected positions and as many"),
        (lambda: stepping(mass=ca.SX.eye(2)), r"mass has shape \(2, 2\), expected \(1, 1\)"),
        (lambda: stepping(impulse=lambda q, v, u: ca.SX(2, 1)), r"impulse\(q, v, u\) has shape"),
        (lambda: stepping(distance=lambda q: ca.vertcat(q, q)), r"distance\(q\) has shape"),
        (
            lambda: stepping(distance=None),
            "give its contacts a distance, or, where they never open",
        ),
        (lambda: stepping(load=1.0), "give its contacts a distance, or, where they never open"),
        (
            lambda: stepping(distance=None, load=1.0, friction=0.5),
            "a load with sliding and friction",
        ),
        (lambda: stepping(mass=ca.SX.sym("m")), "uses m, which is not a state, input, contact or"),
        (lambda: pushing(stiffness=ca.SX.eye(2)), r"stiffness has shape \(2, 2\)"),
        (lambda: pushing(mass=ca.SX.eye(2)), r"mass has shape \(2, 2\), expected \(1, 1\)"),
        (lambda: matrices(C=np.ones((2, 1))), r"matrix C has shape \(2, 1\), expected \(1, 1\)"),
        (lambda: matrices(d=[1, 2]), r"vector d has shape \(2, 1\), expected \(1, 1\)"),
        (lambda: is_p_matrix(np.ones((2, 3))), r"square matrix, got shape \(2, 3\)"),
        (lambda: is_p_matrix([[np.nan]]), "finite square matrix"),
    ],
)
def test_wrong_dimensions_get_their_sentence(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


STEPS = {
    "Euler": (lambda h, k: {"A": 1 + h * k, "B": h}, True),
    "drift": (lambda h, k: {"A": 1 + h * k, "B": h**2 / 2, "c": h * k}, True),
    "push alone": (lambda h, k: {"A": ca.SX(1), "B": h}, True),
    "state forgotten": (lambda h, k: {"A": h * k, "B": h}, False),
    "state turned": (lambda h, k: {"A": h * k - 1, "B": h}, False),
    "input placed": (lambda h, k: {"A": 1 + h * k, "B": k}, False),
    "jump": (lambda h, k: {"A": 1 + h * k, "B": h, "c": k}, False),
}


@pytest.mark.parametrize("name", STEPS)
def test_h_is_only_a_step_size_where_a_step_of_length_zero_changes_nothing(name):
    """The limit ``x+ - x`` at h -> 0 without contact is evaluated at random states and inputs."""
    table = ParameterTable([Parameter("h", 0.1, "s"), Parameter("rate", 2.0, "1/s")])
    made, refinable = STEPS[name]
    system = matrices(**made(table["h"], table["rate"]), h=table["h"], parameters=table)
    change = ca.Function("change", [system.x, system.u, system.parameters.vector], [system.reduced.a - system.x])
    x, u = np.random.default_rng(0).normal(size=2)
    assert (abs(float(change(x, u, [1e-12, 2.0]))) < 1e-9) == refinable == system.refinable
    assert not matrices(**made(ca.SX(0.1), ca.SX(2)), h=0.1).refinable, "h is a number"


def test_a_system_counts_its_names():
    x, x_next, u, lam = (ca.SX.sym(name) for name in ("x", "x_next", "u", "lam"))
    with pytest.raises(ValueError, match="residual has 2 entries, but there are 1 named states"):
        ContactSystem(
            name="odd",
            x=x,
            u=u,
            x_next=x_next,
            lam=lam,
            residual=ca.vertcat(x_next, x),
            gap=lam,
            states=signals("x [m]"),
            inputs=signals("u [N]"),
            contacts=signals("c [N]"),
            h=0.1,
        )


def test_a_step_that_is_not_affine_is_refused_by_name():
    x, x_next, u, lam = (ca.SX.sym(name) for name in ("x", "x_next", "u", "lam"))
    system = ContactSystem(
        name="curved",
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next**2 - u - lam,
        gap=x_next,
        states=signals("x [m]"),
        inputs=signals("u [N]"),
        contacts=signals("c [N]"),
        h=0.1,
    )
    with pytest.raises(ValueError, match=r"'curved': the step is not affine in \(x_next, lam\)"):
        _ = system.reduced


def test_two_parameters_of_one_name_are_refused():
    first, second = Parameter("m", 1.0), Parameter("m", 1.0)
    assert (ParameterTable([first]) + ParameterTable([first])).names == ["m"]
    with pytest.raises(ValueError, match="two different parameters share the name 'm'"):
        _ = ParameterTable([first]) + ParameterTable([second])


def test_signals_read_names_units_and_meanings():
    assert signals("x [m] place; v [m/s]; n") == (
        Signal("x", "m", "place"),
        Signal("v", "m/s", ""),
        Signal("n", "1", ""),
    )


@pytest.mark.parametrize("name", problems.names()[:5])
def test_the_affine_form_solves_the_residual(name):
    problem = problems.get(name)
    system, p = problem.system, problem.parameters.values
    rng = np.random.default_rng(0)
    x, u = problem.initial_states(p)[0], rng.normal(size=system.nu)
    lam = rng.uniform(0, 1, system.nlam)
    form = system.reduced
    symbols = [system.x, system.u, system.lam, system.parameters.vector]
    next_state = form.a + form.B @ system.lam
    outputs = [next_state, form.z + form.F @ system.lam]
    x_next, gap = ca.Function("affine", symbols, outputs)(x, u, lam, p)
    relation = ca.Function(
        "relation",
        [system.x, system.u, system.x_next, system.lam, system.parameters.vector],
        [system.residual, system.gap],
    )
    residual, expected = relation(x, u, x_next, lam, p)
    assert np.max(np.abs(np.array(residual))) <= 1e-11
    assert np.allclose(np.array(gap), np.array(expected), atol=1e-12)


def test_cart_walls_is_well_posed():
    problem = problems.get("cart-walls")
    F = Barrier().close(problem.system).data([0, 0, 0, 0], 0, [*problem.parameters.values, 1])[3]
    assert is_p_matrix(np.array(F))
    assert not is_p_matrix(-np.array(F))


@pytest.mark.parametrize(
    ("changes", "is_lcp"),
    [
        ({}, True),
        ({"mass": lambda q: 1 + q**2}, False),
        ({"distance": lambda q: q + q**2}, False),
        ({"mass": lambda q: 1 + q**2, "distance": lambda q: q + q**2}, False),
    ],
)
def test_contact_is_linear_where_gaps_are_affine_and_inertia_is_constant(changes, is_lcp):
    assert stepping(**changes).is_lcp == is_lcp


@pytest.mark.parametrize("push", [-40.0, -3.0, 0.5, 40.0])
@pytest.mark.parametrize(("damping", "stiffness"), [(0.0, 0.0), (3.0, 200.0)])
def test_a_pressed_block_on_a_spring_sticks_below_its_bound_and_slides_above(push, damping, stiffness):
    """Implicit Euler: ``(m + h d + h² k) v+ = m v + h (u - k q) + f``, |f| <= h times friction times load."""
    h, m, friction, load, q, v = 0.1, 2.0, 0.5, 10.0, 0.03, 0.2
    system = stepping(
        distance=None,
        mass=ca.SX(m),
        impulse=lambda q, v, u: h * u,
        damping=ca.SX(damping),
        stiffness=ca.SX(stiffness),
        sliding=lambda q: ca.SX(1),
        friction=friction,
        load=load,
        h=h,
    )
    step = Exact().close(system)
    x_next, lam, gap, error = (np.array(value).ravel() for value in step.solve([q, v], [push], step.p.values))
    smooth, bound = m * v + h * (push - stiffness * q), h * friction * load
    slid = np.sign(smooth) * max(0.0, abs(smooth) - bound) / (m + h * damping + h**2 * stiffness)
    np.testing.assert_allclose(x_next, [q + h * slid, slid], atol=1e-9)
    np.testing.assert_allclose(lam, np.maximum([h * slid, -h * slid], 0), atol=1e-9)
    f = -np.clip(smooth, -bound, bound)
    np.testing.assert_allclose(gap, [bound + f, bound - f], atol=1e-9)
    assert error.max() < 1e-9


@pytest.mark.parametrize("text", ["x m", "x [m", "x m]", "[m", "x place [m"])
def test_signals_without_a_unit_in_brackets_are_refused(text):
    with pytest.raises(ValueError, match="needs its unit in brackets"):
        signals(f"y [m]; {text}")


def test_limits_are_two_numbers_with_the_lower_one_first():
    symbol = ca.SX.sym("low")
    for value in (None, (-1.0, 2.0), (symbol, 2.0), (1.0, symbol)):
        require_limits("joint", value)
    for value in ((2.0, -1.0), (1.0, 1.0)):
        with pytest.raises(ValueError, match=f"joint limits are {value[0]:g} to {value[1]:g}; expected the lower"):
            require_limits("joint", value)


def test_a_step_does_not_ask_for_an_order_of_its_equations():
    """With velocity before position the equations have no pivots in their order, but the step is the same."""
    x, x_next = ca.SX.sym("x", 2), ca.SX.sym("x_next", 2)
    u, lam = ca.SX.sym("u"), ca.SX.sym("lam")
    rows = [x_next[0] - x[0] - 0.1 * x_next[1], x_next[1] - x[1] - u - lam]

    def stepped(order: list[int]) -> list[np.ndarray]:
        system = ContactSystem(
            name="curved",
            x=x,
            u=u,
            x_next=x_next,
            lam=lam,
            residual=ca.vertcat(*(rows[i] for i in order)),
            gap=x_next[0] + x_next[0] ** 2 / 4,
            states=signals("q [m]; v [m/s]"),
            inputs=signals("u [N s]"),
            contacts=signals("wall [N s]"),
            h=0.1,
        )
        step = Barrier(mu=1e-3).close(system).map
        at = [0.1, -2.0], [0.3], [1e-3]
        return [np.array(v) for v in (*step(*at), *step.jacobian()(*at, *step(*at)))]

    for one, other in zip(stepped([0, 1]), stepped([1, 0]), strict=True):
        assert np.all(np.isfinite(one))
        assert np.allclose(one, other, rtol=1e-12, atol=1e-12)
