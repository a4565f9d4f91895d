"""Solvers called as those of nlpsol: closed forms, multipliers, derivatives, warm starts, outside functions."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from ocp import complements, mpcc_solver
from ocp.errors import InputError, NotConverged

SYMBOLS = pytest.mark.parametrize("sym", [ca.SX.sym, ca.MX.sym], ids=["SX", "MX"])


def bilevel(sym) -> dict:
    """The follower's y is min(x, p); the leader pays ``(x - 2)² + (y - 3)²``, so x = min(2.5, max(2, p)) at best."""
    z, p = sym("z", 3), sym("p")
    x, y, s = ca.vertsplit(z)
    cost = (x - 2) ** 2 + (y - 3) ** 2
    return {"x": z, "p": p, "f": cost, "g": y - x + s, "pairs": complements(s, p - y)}


def optimum(p: float) -> tuple[float, float]:
    """Return the leader's x and cost: with y = x the best is 2.5, which needs x <= p; with y = p it is 2."""
    if p >= 2.5:
        return 2.5, 0.5
    return (2.0, (p - 3) ** 2) if p <= 2 else (p, (p - 2) ** 2 + (p - 3) ** 2)


@pytest.mark.cheap_cases("True-MX")
@SYMBOLS
@pytest.mark.parametrize("warm", [False, True])
def test_a_solver_is_called_again_with_other_parameters(sym, warm: bool) -> None:
    solver = mpcc_solver("leader", bilevel(sym), {"warm_start": warm})
    for p in (-1.0, 1.0, 1.5, 5.0):
        result = solver(p=p, lbg=0.0, ubg=0.0)
        x, cost = optimum(p)
        assert result["report"].success and result["report"].certificate.stationarity == "B"
        assert float(result["f"]) == pytest.approx(cost, abs=1e-6)
        assert float(result["x"][0]) == pytest.approx(x, abs=1e-5)
        assert result["report"].strategy == "warm start" if warm and p > -1 else True
    assert solver.stats()["success"]


def test_later_calls_compile_no_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    made, nlpsol = [], ca.nlpsol
    monkeypatch.setattr(ca, "nlpsol", lambda *arguments: made.append(1) or nlpsol(*arguments))
    solver = mpcc_solver("leader", bilevel(ca.SX.sym))
    solver(p=1.0, lbg=0.0, ubg=0.0)
    first = len(made)
    result = solver(p=1.2, lbg=0.0, ubg=0.0, ubx=[1.9, 9.0, 9.0])
    assert first and len(made) == first
    assert float(result["x"][0]) == pytest.approx(1.9, abs=1e-6)


def test_multipliers_have_the_signs_of_casadi_and_derivatives_are_those_of_differences() -> None:
    """``df/dx + lam_g' dg/dx + lam_x + lam_G' dG/dx + lam_H' dH/dx = 0``, with every kind of row active."""
    x, p = ca.SX.sym("x", 5), ca.SX.sym("p", 2)
    f = ca.sumsqr(x - ca.vertcat(2, 3, p[0], -1, 1)) + x[0] * x[1]
    g = ca.vertcat(x[0] + x[1] + x[2], 2 * x[0], x[3] - p[1], x[4], x[1] ** 2 - x[4])
    G, H = ca.vertcat(x[2] - x[3], x[1]), ca.vertcat(x[0] + x[3] + 2, x[4])
    solver = mpcc_solver("rows", {"x": x, "p": p, "f": f, "g": g, "pairs": (G, H)}, {"warm_start": True})
    limits = {"lbg": [-9, -9, 0, 0, -9], "ubg": [2.5, 3, 9, np.inf, 9], "ubx": [9, 2, 0.4, 9, 9]}
    start, p0 = [1.0, 1.0, 0.3, 0.2, 0.0], np.array([1.0, 0.1])
    result = solver(x0=start, p=p0, **limits)
    assert result["report"].success
    slopes = ca.Function("slopes", [x, p], [ca.jacobian(part, x) for part in (f, g, G, H)])
    df, dg, dG, dH = (np.array(part) for part in slopes(result["x"], p0))
    lam_x, lam_g, pairs = (np.array(result[key]) for key in ("lam_x", "lam_g", "lam_pairs"))
    total = df.T + dg.T @ lam_g + lam_x + dG.T @ pairs[:, :1] + dH.T @ pairs[:, 1:]
    np.testing.assert_allclose(total, 0.0, atol=1e-6)
    values = np.array(result["g"]).ravel()
    for low, high, value, multiplier in zip(limits["lbg"], limits["ubg"], values, lam_g.ravel(), strict=True):
        assert abs(multiplier) < 1e-6 or value == pytest.approx(high if multiplier > 0 else low, abs=1e-6)
    assert np.abs(lam_g).max() > 0.1 and np.abs(lam_x).max() > 0.1
    slope = solver.sensitivity()
    for i in range(2):
        ends = [solver(x0=result["x"], p=p0 + s * 1e-4 * np.eye(2)[i], **limits) for s in (1, -1)]
        dx = np.array(ends[0]["x"] - ends[1]["x"]).ravel() / 2e-4
        np.testing.assert_allclose(slope["x"][:, i], dx, atol=1e-4)
        assert slope["f"][i] == pytest.approx(float(ends[0]["f"] - ends[1]["f"]) / 2e-4, abs=1e-4)


@pytest.mark.parametrize(("p", "expected"), [(-3.0, -1.0), (0.25, 0.25), (7.0, 2.0)])
def test_mixed_complementarity_is_a_projection(p: float, expected: float) -> None:
    """``l <= x <= u`` complementary to ``x - p`` has the solution clip(p, l, u); limits may be parameters."""
    x, q = ca.MX.sym("x"), ca.MX.sym("q", 2)
    relation = complements(x - q[0], x, lower=-1.0, upper=q[1])
    solver = mpcc_solver("projection", {"x": x, "p": q, "f": x, "g": 2 * x, "pairs": relation})
    result = solver(p=[p, 2.0], lbg=-7.0, ubg=9.0)
    assert result["report"].success
    assert float(result["x"]) == pytest.approx(expected, abs=1e-7)


def test_vertical_complementarity_is_a_minimum() -> None:
    """The largest x with ``min(4 - x, 3 - 2 x, 1 + x) = 0`` is 1.5; the only other solution is -1."""
    x = ca.SX.sym("x")
    for sign, expected in ((-1, 1.5), (1, -1.0)):
        sides = complements(4 - x, 3 - 2 * x, 1 + x)
        result = mpcc_solver("vertical", {"x": x, "f": sign * x, "pairs": sides})(x0=0.1 * -sign)
        assert result["report"].success
        assert float(result["x"]) == pytest.approx(expected, abs=1e-6)


class Exponential(ca.Callback):
    """``exp(x)`` evaluated outside CasADi, with derivatives by differences."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.construct("exponential", {"enable_fd": True})

    def eval(self, arg):
        return [np.exp(np.array(arg[0]))]


@pytest.mark.parametrize("kind", ["callback", "rootfinder", "linear solve"])
def test_functions_from_outside_are_differentiated_by_casadi(kind: str) -> None:
    """``max x - 5 y`` with ``0 <= y ⟂ y + 1 - h(x) >= 0`` and h(x) = exp(x) or x + 1 or 3 x: x is where h(x) = 1."""
    x, y, z = ca.MX.sym("x"), ca.MX.sym("y"), ca.MX.sym("z")
    outside = Exponential()
    root = ca.rootfinder("root", "newton", {"x": z, "p": x, "g": z**3 + z - 2 * x})
    h = {
        "callback": lambda: outside(x),
        "rootfinder": lambda: root(x0=0.5, p=x)["x"],
        "linear solve": lambda: ca.solve(ca.diag(ca.vertcat(1 / 3, x + 1)), ca.vertcat(x, 1.0))[0],
    }[kind]()
    solver = mpcc_solver("outside", {"x": ca.vertcat(x, y), "f": 5 * y - x, "pairs": (y, y + 1 - h)})
    result = solver(x0=[0.2, 0.1], lbx=[-1.0, -np.inf], ubx=[2.0, np.inf])
    assert result["report"].success
    expected = {"callback": 0.0, "rootfinder": 1.0, "linear solve": 1 / 3}[kind]
    assert np.array(result["x"]).ravel() == pytest.approx([expected, 0.0], abs=1e-5)


def test_a_callback_sees_every_run() -> None:
    seen: list[tuple[int, np.ndarray]] = []
    options = {"callback": lambda runs, z: seen.append((runs, z.copy()))}
    result = mpcc_solver("leader", bilevel(ca.SX.sym), options)(p=1.0, lbg=0.0, ubg=0.0)
    assert [runs for runs, _ in seen] == list(range(len(seen)))
    last = np.array([z for _, z in seen])
    assert np.abs(last - np.array(result["x"]).ravel()).max(axis=1).min() < 1e-6


def far() -> dict:
    x = ca.SX.sym("x", 2)
    return {"x": x, "f": x[0], "g": ca.sum1(x), "pairs": (x[0], x[1])}


def test_what_cannot_be_met_is_named() -> None:
    result = mpcc_solver("far", far())(lbg=-2.0, ubg=-1.0)
    assert not result["report"].success and "g[0]" in result["report"].verdict
    assert np.all(np.isnan(np.array(result["lam_x"])))


def test_a_call_without_an_answer_raises_where_asked_to() -> None:
    with pytest.raises(NotConverged, match=r"g\[0\]"):
        mpcc_solver("far", far(), {"error_on_fail": True})(lbg=-2.0, ubg=-1.0)


W = ca.SX.sym("w")


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"h": 1}, {}, "unknown entry of the problem 'h'"),
        ({"x": None}, {}, "no x"),
        ({"f": ca.SX(2, 1)}, {}, "f has 2 entries"),
        ({"f": ca.SX.sym("w")}, {}, "w is neither in x nor in p"),
        ({"pairs": [ca.SX.sym("z") == 0]}, {}, r"pairs\[0\]"),
        ({"x": 3.0}, {}, "x is 3.0; expected a column of symbols"),
        ({"x": ca.SX.sym("A", 2, 2)}, {}, r"expected a column of symbols"),
        ({"x": ca.vertcat(W, W)}, {}, "a symbol occurs twice"),
        ({"x": W, "p": W}, {}, "a symbol occurs twice"),
        ({"p": 2 * W}, {}, "p is .*; expected a column of symbols"),
        ({"f": "x"}, {}, "f got a str; expected SX"),
        ({"f": ca.SX(np.nan)}, {}, "f has an entry that is always nan"),
        ({"g": ca.SX(np.nan)}, {}, "g has an entry that is always nan"),
        ({"pairs": "xy"}, {}, r"pairs\[0\] is xy; expected a tuple"),
        ({"pairs": [[W, W]]}, {}, r"pairs\[0\] is .*; expected a tuple"),
        ({"pairs": [(ca.MX.sym("a"), 1)]}, {}, "an expression of MX, and x is SX"),
        ({}, {"warmstart": True}, "did you mean 'warm_start'"),
        ({}, {"warm_start": "yes"}, "'warm_start' is 'yes'; expected True or False"),
        ({}, {"ipopt": 3}, "option 'ipopt' is a int; expected a dictionary"),
        ({}, {"strategies": "scholtes"}, "expected a list of names"),
        ({}, {"callback": 3}, "expected a function"),
        ({}, ["warm_start"], "options is a list; expected a dictionary"),
    ],
)
def test_bad_problems_are_refused(change: dict, options: Any, message: str) -> None:
    problem = {key: value for key, value in {**bilevel(ca.SX.sym), **change}.items() if value is not None}
    with pytest.raises(InputError, match=message):
        mpcc_solver("leader", problem, options)


def test_bad_arguments_are_refused() -> None:
    solver = mpcc_solver("leader", bilevel(ca.SX.sym))
    with pytest.raises(InputError, match="lbx has 2 entries, expected 3"):
        solver(lbx=[0.0, 1.0])
    with pytest.raises(InputError, match=r"ubx\[1\] is nan, expected a number"):
        solver(ubx=[1.0, np.nan, 1.0])
    with pytest.raises(InputError, match=r"p\[0\] is inf, expected a finite number"):
        solver(p=np.inf)
    with pytest.raises(InputError, match="x0 is 'here'; expected numbers"):
        solver(x0="here")
    with pytest.raises(InputError, match="not been called"):
        solver.sensitivity()


def test_a_cost_with_an_infinite_term_is_refused() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    solver = mpcc_solver("endless", {"x": ca.vertcat(x, y), "f": x + y + np.inf, "pairs": [(x, y)]})
    with pytest.raises(InputError, match="constant terms of the cost are inf"):
        solver()
