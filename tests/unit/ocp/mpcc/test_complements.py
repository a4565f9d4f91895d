"""Constraints of complementarity as expressions: what they mean, and that they are read back."""

from __future__ import annotations

from itertools import product

import casadi as ca
import numpy as np
import pytest

from ocp import complements
from ocp.errors import InputError
from ocp.mpcc.complements import relation_of
from ocp.mpcc.forms import StandardForm

VALUES = (-1.0, 0.0, 0.5, 2.0)


def residual(constraint: ca.SX | ca.MX, symbols: list, values: tuple[float, ...]) -> float:
    """Return whether the constraint holds at the values, as 1 or 0."""
    return float(ca.Function("holds", symbols, [constraint])(*values))


@pytest.mark.parametrize("sym", [ca.SX.sym, ca.MX.sym], ids=["SX", "MX"])
def test_the_expression_holds_exactly_where_the_sides_are_complementary(sym) -> None:
    a, b, c = (sym(name) for name in "abc")
    two, three = complements(a, b), complements(a, b, c)
    mixed = complements(a, b, lower=0.0, upper=2.0)
    for x, y, z in product(VALUES, repeat=3):
        assert residual(two, [a, b], (x, y)) == (x >= 0 and y >= 0 and x * y == 0)
        assert residual(three, [a, b, c], (x, y, z)) == (min(x, y, z) == 0)
        inside = 0 <= y <= 2 and (x == 0 or (y == 0 and x > 0) or (y == 2 and x < 0))
        assert residual(mixed, [a, b], (x, y)) == inside


@pytest.mark.parametrize("sym", [ca.SX.sym, ca.MX.sym], ids=["SX", "MX"])
def test_a_relation_is_read_back_from_its_expression(sym) -> None:
    x, p = sym("x", 2, 3), sym("p")
    relation = relation_of(complements(x, 1 - x, x * p, lower=0.0))
    assert relation is not None and relation.size == 6
    values = np.arange(6.0)
    sides = ca.Function("sides", [x, p], list(relation.sides))(values.reshape(2, 3, order="F"), 2.0)
    for side, expected in zip(sides, (values, 1 - values, 2 * values), strict=True):
        np.testing.assert_array_equal(np.array(side).ravel(), expected)
    assert relation_of(x[0] * x[1] == 0) is None
    assert relation_of(x[0]) is None


def solutions(form: StandardForm, x: list[ca.SX], grid: np.ndarray) -> list[tuple[float, ...]]:
    """Return the points of a grid in (x, new variables) at which the pairs and equations of a form hold."""
    symbols = ca.vertcat(*x, *form.variables)
    empty = ca.SX(0, 1)
    expressions = [ca.vertcat(empty, *part) for part in (form.G, form.H, form.rows)]
    function = ca.Function("form", [symbols], expressions)
    points = set()
    for point in product(grid, repeat=symbols.numel()):
        G, H, rows = (np.array(part).ravel() for part in function(point))
        if np.all(np.minimum(G, H) == 0) and np.all(rows == 0) and np.all(np.array(point[len(x) :]) >= form.lower):
            points.add(point[: len(x)])
    return sorted(points)


def test_standard_forms_have_the_same_solutions_as_their_relations() -> None:
    """Enumerated on a grid of integers, on which the new variables are integers too."""
    grid = np.arange(-2.0, 3.0)
    symbols = [ca.SX.sym(name) for name in "abc"]
    for count, limits in ((2, (0.0, np.inf)), (2, (-np.inf, 1.0)), (2, (-1.0, 1.0)), (2, (-np.inf, np.inf)), (3, None)):
        x = symbols[:count]
        keywords = {} if limits is None else {"lower": limits[0], "upper": limits[1]}
        constraint = complements(*x, **keywords)
        relation = relation_of(constraint)
        assert relation is not None
        form = StandardForm()
        form.add(relation)
        holds = ca.Function("holds", x, [constraint])
        expected = sorted(point for point in product(grid, repeat=count) if float(holds(*point)))
        assert expected and solutions(form, x, grid) == expected


def test_starts_of_new_variables_meet_the_equations() -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    form = StandardForm()
    relation = relation_of(complements(a - 2 * b, b, lower=-1.0, upper=1.0))
    assert relation is not None
    form.add(relation)
    rows = ca.Function("rows", [a, b, *form.variables], form.rows)
    starts = ca.Function("starts", [a, b], form.starts)
    for point in product(VALUES, repeat=2):
        parts = starts(*point)
        assert float(rows(*point, *parts)) == 0 and min(map(float, parts)) == 0


x, y, m = ca.MX.sym("x", 2), ca.MX.sym("y", 3), ca.SX.sym("m", 2)


@pytest.mark.parametrize(
    ("sides", "limits", "message"),
    [
        ((x,), {}, "two sides or more"),
        ((x, y), {}, "2x1 and 3x1"),
        ((x, m), {}, "mixes SX and MX"),
        ((1.0, 2.0), {}, "no symbolic side"),
        ((x, x, 1.0), {"upper": 1.0}, "limits with two sides only"),
        (("a", x), {}, "got a str; expected MX expressions or numbers"),
        (([x[0], x[1]], [x[1], x[0]]), {}, "a vertcat of them"),
        ((x, np.nan), {}, "a side that is nan"),
        ((x, np.inf), {}, "a side that is inf"),
        ((x, x), {"lower": 1.0, "upper": 0.0}, "lower 1 and upper 0"),
        ((x, x), {"lower": np.nan}, "lower nan"),
        ((x, x), {"lower": np.inf}, "lower inf"),
        ((x, x), {"upper": -np.inf}, "upper -inf"),
    ],
)
def test_bad_sides_are_refused(sides, limits, message: str) -> None:
    with pytest.raises(InputError, match=message):
        complements(*sides, **limits)
