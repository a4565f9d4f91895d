"""Systems whose multipliers are not unique are recognised from their structure alone."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.contact import AffineStep, Exact, ImplicitStep
from dynamics.systems import ContactSystem, ParameterTable, lcs, quasi_dynamic, signals

AFFINE = {
    "wall-1d",
    "push-1d",
    "push-disc",
    "ball-bounce",
    "cart-walls",
    "box-slide",
    "cart-transport",
    "ball-throw",
    "hopper-1d",
    "push-box",
    "push-t",
    "soft-walls",
}


@pytest.mark.costly_cases(
    "quadruped", "ant", "hopper", "half-cheetah", "finger-disc", "idto-hopper", "push-cube", "reorient"
)
@pytest.mark.parametrize("name", problems.names())
def test_named_problems_find_their_step(name: str) -> None:
    kind = AffineStep if name in AFFINE else ImplicitStep
    assert type(Exact().close(problems.get(name).system)) is kind


def two_gaps(first, second, **changes) -> ContactSystem:
    """Return a system of a body on a line and a finger on a spring, q = (x, a), with two gaps."""
    return quasi_dynamic(
        "two",
        states=signals("x [m]; a [m]"),
        inputs=signals("u [m]"),
        contacts=signals("one [N s]; other [N s]"),
        h=0.1,
        mass=1.0,
        stiffness=100.0,
        distance=lambda q: ca.vertcat(first(q), second(q)),
        parameters=ParameterTable(),
        **changes,
    )


def push(q: ca.SX) -> ca.SX:
    return q[0] - q[1]


def test_contacts_are_open_only_where_they_may_close_at_once() -> None:
    """A second wall behind the first, or opposite to it, cannot be touched at the same time."""
    assert two_gaps(push, lambda q: 2.0 - q[0]).is_lcp, "two directions"
    assert two_gaps(push, lambda q: push(q) + 0.1).is_lcp, "one behind the other"
    assert two_gaps(push, lambda q: 0.5 - push(q)).is_lcp, "two walls across from each other"
    assert not two_gaps(push, push).is_lcp, "the same contact twice"
    assert not two_gaps(push, lambda q: 2 * push(q)).is_lcp
    three = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    more = quasi_dynamic(
        "three",
        states=signals("x [m]; a [m]"),
        inputs=signals("u [m]; w [m]"),
        contacts=signals("one [N s]; two [N s]; three [N s]"),
        h=0.1,
        mass=ca.SX(0, 0),
        stiffness=ca.SX.eye(2),
        distance=lambda q: three @ q,
        parameters=ParameterTable(),
    )
    assert not more.is_lcp, "three lines through one point"


def test_friction_is_open_whatever_its_coefficient_is() -> None:
    rough = {"friction": 0.4, "sliding": lambda q: ca.SX([[0.0, 1.0], [0.0, 1.0]])}
    assert not two_gaps(push, lambda q: 2.0 - q[0], **rough).is_lcp


def test_the_same_contact_twice_is_one_contact() -> None:
    """Its two impulses are not unique, but their sum and their effect are."""
    twice, once = two_gaps(push, push), two_gaps(push, lambda q: 5.0 - q[0])
    x, u = np.array([0.1, 0.0]), 0.5
    ends = []
    for system in (twice, once):
        step = Exact().close(system)
        x_next, lam, _, error = (np.array(v).ravel() for v in step.solve(x, u, step.p.values))
        assert error.max() <= 1e-7
        ends.append((x_next, lam.sum()))
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-7)
    assert ends[0][1] == pytest.approx(ends[1][1], abs=1e-6)


def test_a_singular_lcs_is_found() -> None:
    row, one = np.ones((2, 1)), np.ones((1, 2))
    singular = lcs("s", A=[[1.0]], B=[[1.0]], C=one, D=row, E=row, F=np.ones((2, 2)))
    regular = lcs("r", A=[[1.0]], B=[[1.0]], C=one, D=row, E=row, F=np.ones((2, 2)) + np.eye(2))
    assert regular.is_lcp and not singular.is_lcp
