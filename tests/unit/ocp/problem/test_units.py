"""Sizes and plans change consistently with the units of mass, length and time."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.systems import Parameter, ParameterTable, signals, time_stepping
from ocp import Solution, solve
from ocp.problem.problem import Problem, Scaling
from ocp.problem.sizes import derive_sizes
from ocp.programs.units import row_units, solver_unit

SI = (1.0, 1.0, 1.0)
"""Units of mass [kg], length [m] and time [s]."""


def wall(units: tuple[float, float, float], **scaling: float) -> Problem:
    """Return a problem of a mass that its brake cannot stop before a wall, with all numbers in ``units``.

    The names of the units stay those of SI, so that only the numbers differ. The cost has no unit.
    """
    kg, m, s = units
    force = kg * m / s**2
    table = ParameterTable([Parameter("h", 0.1 / s, "s"), Parameter("m", 1.3 / kg, "kg")])
    system = time_stepping(
        "wall",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("F [N]"),
        contacts=signals("wall [N s]"),
        h=table["h"],
        mass=table["m"],
        impulse=lambda q, v, u: table["h"] * u,
        distance=lambda q: q,
        parameters=table,
    )
    off, v = (system.x[0] - 0.2 / m) * m, system.x[1] * m / s
    return Problem(
        "wall",
        system,
        12,
        0.1 * (system.u * force) ** 2,
        10 * off**2 + 10 * v**2,
        ca.SX([1.0 / m, -3.0 * s / m]),
        table,
        u_lower=-1 / force,
        u_upper=1 / force,
        scaling=Scaling(**scaling),
    )


def factors(units: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return the factors from states, inputs, impulses and gaps in ``units`` to those in SI units."""
    kg, m, s = units
    return np.array([m, m / s]), np.array([kg * m / s**2]), kg * m / s, m


@pytest.mark.parametrize("seed", range(12))
def test_derived_sizes_are_those_of_any_units(seed: int) -> None:
    units = tuple(10.0 ** np.random.default_rng(seed).uniform(-6, 6, 3))
    known, found = derive_sizes(wall(SI)), derive_sizes(wall(units))
    by_x, by_u, by_impulse, by_gap = factors(units)
    np.testing.assert_allclose(found.x * by_x, known.x, rtol=1e-9)
    np.testing.assert_allclose(found.u * by_u, known.u, rtol=1e-9)
    assert found.impulse * by_impulse == pytest.approx(known.impulse, rel=1e-9)
    assert found.gap * by_gap == pytest.approx(known.gap, rel=1e-9)


def test_sizes_are_those_of_the_motion() -> None:
    """At 3 m/s the mass reaches the wall, 1 m away, within the horizon of 1.2 s."""
    sizes = derive_sizes(wall(SI))
    assert sizes.x == pytest.approx([1.0, 3.0], rel=0.3)
    assert sizes.u == pytest.approx([1.0])
    # The impulse stops the mass or, if that is less, moves it by a twelfth of its distance in a step.
    assert sizes.impulse == pytest.approx(1.3 * min(sizes.x[1], sizes.x[0] / 12 / 0.1), rel=1e-9)
    assert sizes.gap == pytest.approx(0.1 * sizes.x[0], rel=1e-9)


@pytest.mark.parametrize("name", ["impulse", "gap", "x", "u"])
def test_a_stated_size_wins_and_the_others_are_derived(name: str) -> None:
    """The other sizes are derived from those of the states."""
    scales = wall(SI, **{name: 7.5}).scales
    derived = derive_sizes(wall(SI), np.full(2, 7.5) if name == "x" else None)
    for size in ("impulse", "gap", "x", "u"):
        wanted = 7.5 if size == name else getattr(derived, size)
        np.testing.assert_allclose(getattr(scales, size), wanted, rtol=1e-12)
    assert name not in wall(SI, **{name: 7.5}).scaling.derived


OTHERS = {
    "micrometres": (1.0, 1e-6, 1.0),
    "milligrams": (1e-6, 1.0, 1.0),
    "microseconds": (1.0, 1.0, 1e-6),
    "megametres": (1.0, 1e6, 1.0),
    "all small": (1e-6, 1e-6, 1e-3),
}


@functools.cache
def solved(units: tuple[float, float, float], soft: bool) -> Solution:
    kg, m, s = units
    law: ContactLaw = Barrier(mu=1e-4 / (kg * m**2 / s)) if soft else Exact()
    return solve(wall(units), law)


def words(found: Solution) -> list[str]:
    """Return the verdict without costs, and without lines on sizes, which depend on the units."""
    lines = found.verdict.splitlines()[1:]
    return [
        found.status.label,
        found.grade,
        *(line for line in lines if "sizes" not in line.lower()),
    ]


@pytest.mark.cheap_cases("microseconds-barrier")
@pytest.mark.parametrize("soft", [False, True], ids=["exact", "barrier"])
@pytest.mark.parametrize("name", OTHERS)
def test_a_plan_is_the_same_in_any_units(name: str, soft: bool) -> None:
    known, found = solved(SI, soft), solved(OTHERS[name], soft)
    assert known.success
    assert found.cost == pytest.approx(known.cost, rel=1e-7)
    assert words(found) == words(known)
    assert found.referee.survives == known.referee.survives


@pytest.mark.parametrize("size", [1e-9, 3e-3, 0.3, 1.0, 100.0, 500.0, 1e9])
def test_units_of_a_solver_are_powers_of_two_beside_sizes_that_are_not_ordinary(
    size: float,
) -> None:
    unit = float(solver_unit(size))
    assert np.log2(unit) == round(np.log2(unit))
    if 2**-7 <= size <= 2**7:
        assert unit == 1.0
    elif unit != 1.0:
        assert 2**-0.5 <= size / unit <= 2**0.5


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf])
def test_what_is_no_size_has_the_unit_one(size: float) -> None:
    assert float(solver_unit(size)) == 1.0


@pytest.mark.parametrize("factor", [1e-12, 1e-9, 1.0, 1e6, 1e12])
def test_a_row_means_the_same_in_whatever_unit_it_is_written(factor: float) -> None:
    """The first of two rows is written in another unit; the second keeps its own."""
    import scipy.sparse as sp

    x = np.array([2.0**20, 1.0])
    rows = np.array([[factor * 2.0**-20, factor * 0.5], [0.0, 3.0]])
    units = row_units(x, lambda x, p: (0.0, sp.csr_matrix(rows)), np.zeros(0))
    assert units[1] == 1.0
    ordinary = 2.0**-13 <= factor <= 2.0**13
    assert units[0] == (1.0 if ordinary else 2.0 ** np.round(np.log2(factor)))
