"""Sizes of a complementarity problem's variables, from its start, bounds, cost and rows."""

from __future__ import annotations

from itertools import product

import casadi as ca
import numpy as np
import pytest

from ocp.mpcc import MPCC, solve
from ocp.mpcc.programs import MPCCProgram, programs_of
from ocp.mpcc.sizes import variable_sizes

NONE = ca.SX(0, 1)
BOX = 5.0
x, y, z = (ca.SX.sym(name) for name in "xyz")


def sizes(mpcc: MPCC, start: list[float]) -> np.ndarray:
    begin = np.array(start, dtype=float)
    program = programs_of(mpcc, np.zeros(0), begin)("none")
    assert isinstance(program, MPCCProgram)
    p = program.parameter_vector({"route.penalty": 0.0, "route.relaxation": 0.0})
    return variable_sizes(program, program.extended(begin), p)


@pytest.mark.parametrize(
    ("mpcc", "start", "size"),
    [
        (MPCC(x, x**4, NONE, NONE), 3e-6, 3e-6),
        (MPCC(x, ca.SX(0), NONE, NONE, lbx=-2e5, ubx=4e5), 0.0, 3e5),
        (MPCC(x, ca.SX(0), NONE, NONE, lbx=7e-9), 0.0, 7e-9),
        (MPCC(x, (x - 5e4) ** 2, NONE, NONE), 0.0, 5e4),
        (MPCC(x, ca.SX(0), NONE, NONE, g=1e9 * x - 2, lbg=0, ubg=0), 0.0, 2e-9),
        (MPCC(x, ca.SX(0), NONE, NONE, g=x, lbg=-np.inf, ubg=-4e3), 0.0, 4e3),
    ],
    ids=["start", "both bounds", "one bound", "Newton step", "equation", "inequality"],
)
def test_a_size_is_that_of_what_is_stated(mpcc: MPCC, start: float, size: float) -> None:
    assert sizes(mpcc, [start]) == pytest.approx([size], rel=1e-9)


def test_the_largest_of_start_bounds_and_cost_counts() -> None:
    mpcc = MPCC(x, (x - 5) ** 2, NONE, NONE, lbx=-1e3, ubx=1e3)
    assert sizes(mpcc, [3.0]) == pytest.approx([1e3])
    assert sizes(mpcc, [4e3]) == pytest.approx([4e3])


def test_sizes_are_carried_over_from_variable_to_variable() -> None:
    """A current of 1e-6 A through 1e9 Ohm gives a voltage of 1e3 V, and that gives a size of 1e5 by the next row."""
    mpcc = MPCC(
        ca.vertcat(x, y, z),
        ca.SX(0),
        NONE,
        NONE,
        g=ca.vertcat(1e9 * x - y, y - 1e-2 * z),
        lbx=[-1e-6, -np.inf, -np.inf],
        ubx=[1e-6, np.inf, np.inf],
    )
    assert sizes(mpcc, [0, 0, 0]) == pytest.approx([1e-6, 1e3, 1e5])


def test_what_nothing_tells_has_no_size() -> None:
    mpcc = MPCC(ca.vertcat(x, y), (x - 2) ** 2 + y, NONE, NONE)
    found = sizes(mpcc, [0, 0])
    assert found[0] == pytest.approx(2)
    assert np.isnan(found[1])


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e6])
def test_sizes_follow_the_unit_of_a_variable(unit: float) -> None:
    """Sizes of a diode's variables change with the unit of its current, up to a small factor.

    The factor arises since rows give a lower limit on the others' sizes only up to 1.
    """
    known, found = (
        MPCC(
            ca.vertcat(x, y, z),
            (x + 1) ** 2 + (5.0 * one * y - 0.5) ** 2,
            y,
            z,
            g=5.0 * one * y - x - z,
            lbx=[-2, -np.inf, -np.inf],
            ubx=[2, np.inf, np.inf],
        )
        for one in (1.0, unit)
    )
    ratio = sizes(found, [0, 0, 0]) * [1, unit, 1] / sizes(known, [0, 0, 0])
    assert np.all((ratio > 0.1) & (ratio < 10))


@pytest.mark.one_case_in(12)
@pytest.mark.parametrize("unit", [1e-4, 3e-3, 0.3, 1e3])
@pytest.mark.parametrize("seed", range(3))
def test_certified_answers_are_optimal_on_their_branch_in_any_unit(unit: float, seed: int) -> None:
    """Convex quadratic costs with two pairs: on each of the four branches the KKT system has one solution.

    Pairs are ``0 <= z_1 ⟂ z_2 >= 0`` and ``0 <= z_3 ⟂ a z + 2 >= 0``, with |z| <= 5, solved in x = unit z.
    """
    generator = np.random.default_rng(seed)
    W, c, a = generator.normal(size=(3, 3)), 3 * generator.normal(size=3), generator.normal(size=3)
    Q, x = W @ W.T + 0.1 * np.eye(3), ca.SX.sym("x", 3)
    z = x / unit
    cost = 0.5 * z.T @ ca.DM(Q) @ z + ca.DM(c).T @ z
    G, H = unit * z[[0, 2]], ca.vertcat(unit * z[1], unit * (ca.DM(a).T @ z + 2))
    solution = solve(MPCC(x=x, f=cost, G=G, H=H, lbx=-BOX * unit, ubx=BOX * unit), unit * np.ones(3))
    assert solution.certificate.certified
    point = np.asarray(solution.x).ravel() / unit
    rows = np.vstack([np.eye(3), a, np.eye(3), -np.eye(3)])
    offsets = np.array([0, 0, 0, 2.0, *[BOX] * 6])
    sides = rows @ point + offsets
    assert sides.min() > -1e-6
    lowest = np.inf
    for first, second in product((0, 1), (2, 3)):
        active = [k for k in (first, second) if sides[k] < 1e-6]
        if len(active) == 2:
            lowest = min(lowest, _least_with_inactive_bounds(Q, c, rows, offsets, active))
    assert 0.5 * point @ Q @ point + c @ point == pytest.approx(lowest, rel=1e-5, abs=1e-5)


def _least_with_inactive_bounds(
    Q: np.ndarray, c: np.ndarray, rows: np.ndarray, offsets: np.ndarray, active: list[int]
) -> float:
    """Return the least cost with the rows ``active`` zero and all others at least zero, by enumeration of bounds."""
    others, least = [k for k in range(len(rows)) if k not in active], np.inf
    for held in product((False, True), repeat=len(others)):
        zero = [*active, *(k for k, is_held in zip(others, held, strict=True) if is_held)]
        if len(zero) > len(c):
            continue
        A = rows[zero]
        kkt = np.block([[Q, A.T], [A, np.zeros((len(zero), len(zero)))]])
        z = np.linalg.lstsq(kkt, np.concatenate([-c, -offsets[zero]]), rcond=None)[0][: len(c)]
        if (rows @ z + offsets).min() > -1e-9 and np.abs((rows @ z + offsets)[zero]).max() < 1e-9:
            least = min(least, 0.5 * z @ Q @ z + c @ z)
    return float(least)
