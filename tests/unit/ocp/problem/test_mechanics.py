"""Invalid step sizes, masses, stiffnesses and friction are rejected wherever they are set."""

from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from dynamics.systems import Parameter, ParameterTable, quasi_dynamic, signals
from ocp import Direct, OpenLoop, Problem
from ocp.continuation import continue_over
from ocp.errors import InputError
from ocp.routes.session import Session


def finger(m: float = 1.0, K: float = 50.0, f: float = 0.5, h: float = 0.1) -> Problem:
    """Return a problem of a body on a line, pushed by a finger on springs that can also move sideways."""
    p = ParameterTable([Parameter("m", m, "kg"), Parameter("K", K, "N/m"), Parameter("f", f), Parameter("h", h, "s")])
    system = quasi_dynamic(
        "finger",
        states=signals("x [m]; a [m] finger; b [m] across"),
        inputs=signals("u [m]; w [m]"),
        contacts=signals("push [N s]"),
        h=p["h"],
        mass=ca.diag(p["m"]),
        stiffness=p["K"] * ca.SX.eye(2),
        distance=lambda q: q[0] - q[1] - 0.1,
        parameters=p,
        sliding=lambda _: ca.SX([[0.0, 0.0, 1.0]]),
        friction=p["f"],
    )
    x = system.x
    return Problem("finger", system, 3, ca.sumsqr(system.u - x[1:]), (x[0] - 1) ** 2, ca.SX([0.0, -0.2, 0.0]), p)


WRONG = [
    ({"m": 0.0}, "mass matrix must be positive definite, but its smallest eigenvalue is 0"),
    ({"m": np.nan}, "mass matrix must be positive definite, but its smallest eigenvalue is nan"),
    ({"K": -3.0}, "stiffness matrix must be positive definite, but its smallest eigenvalue is -3"),
    ({"f": -0.5}, "coefficients of friction must not be negative, got -0.5"),
    ({"h": 0.0}, "step size must be positive, got 0 s"),
]


def session(problem: Problem) -> Session:
    return Session(problem, Exact(), Direct(), OpenLoop())


@pytest.mark.cheap_cases("given1-mass matrix must be positive definite, but its smallest eigenvalue is nan")
@pytest.mark.parametrize(("given", "said"), WRONG)
def test_what_is_no_mechanics_is_refused_when_built_and_when_turned(given, said: str) -> None:
    if np.isfinite([*given.values()]).all():  # A parameter that is not finite is rejected earlier.
        with pytest.raises(InputError, match=re.escape(said)):
            session(finger(**given))
    turned = session(finger())
    turned.values |= given
    with pytest.raises(InputError, match=re.escape(said)):
        turned.solve()
    turned.values |= {p.name: p.value for p in finger().parameters}
    assert turned.solve().finished


@pytest.mark.parametrize(("name", "end"), [("m", -1.0), ("K", 0.0), ("f", -0.1), ("h", -0.1)])
def test_no_curve_is_followed_out_of_mechanics(name: str, end: float) -> None:
    with pytest.raises(InputError, match="finger: "):
        continue_over(session(finger()), name, 0.5, end, 3)


def test_no_curve_is_followed_to_a_law_that_is_none() -> None:
    soft = Session(finger(), Barrier(mu=0.1), Direct(), OpenLoop())
    with pytest.raises(InputError, match=r"mu must be a number > 0 .*, got -1"):
        continue_over(soft, "mu", 1.0, -1.0, 3)
