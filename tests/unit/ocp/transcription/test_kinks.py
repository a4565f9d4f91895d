"""A graph whose kinks have sides is the graph where the sides are those of its numbers, and smooth elsewhere."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from ocp.transcription.kinks import FixedSides

W, P = ca.SX.sym("w", 3), ca.SX.sym("p")
GRAPHS = {
    "absolute value": ca.fabs(W[0] - W[1]),
    "maximum": ca.fmax(W[0], P * W[1]) ** 2,
    "minimum": ca.fmin(ca.sin(W[0]), W[2]) * W[1],
    "Huber": ca.if_else(ca.fabs(W[0]) < 0.5, W[0] ** 2, ca.fabs(W[0]) - 0.25),
    "both": ca.if_else(ca.logic_and(W[0] > W[1], W[1] <= W[2]), ca.exp(W[0]), W[2]),
    "either": ca.if_else(ca.logic_or(W[0] > 0, W[1] > 0), ca.norm_2(W), 1),
    "parameter": ca.if_else(P > 0, W[0], -W[0]),
    "smooth": ca.atan2(W[0], 2 + W[1] ** 2) + ca.sqrt(1 + W[2] ** 2),
}


def rewritten(expression: ca.SX) -> tuple[ca.Function, ca.Function]:
    """Return the functions ``(w, p, sides) -> value`` and ``(w, p) -> margins`` of a rewritten graph."""
    kinks = FixedSides()
    (output,) = kinks.rewrite(W, P, [ca.densify(expression)])
    sides = ca.vertcat(ca.SX(0, 1), *kinks.sides)
    live = ca.substitute(ca.vertcat(ca.SX(0, 1), *kinks.margins), sides, 0 * sides) if kinks.sides else ca.SX(0, 1)
    return ca.Function("value", [W, P, sides], [output]), ca.Function("margins", [W, P], [live])


@pytest.mark.parametrize("name", GRAPHS)
def test_sides_of_the_numbers_give_the_graph(name):
    original = ca.Function("original", [W, P], [GRAPHS[name]])
    value, margins = rewritten(GRAPHS[name])
    for w in np.random.default_rng(0).normal(size=(40, 3)):
        for p in (-1.5, 2.0):
            signs = np.where(np.array(margins(w, p)).ravel() > 0, 1.0, -1.0)
            expected = float(original(w, p))
            assert float(value(w, p, 0 * signs)) == expected
            assert float(value(w, p, signs)) == expected


def test_a_parameter_is_no_kink():
    assert rewritten(GRAPHS["parameter"])[0].numel_in(2) == 0
    assert rewritten(GRAPHS["smooth"])[0].numel_in(2) == 0


def test_the_other_side_continues_the_other_piece():
    """On the side where a counts as less than b, max(a, b) is b, and |a - b| is b - a, wherever a and b are."""
    biggest, distance = rewritten(ca.fmax(W[0], W[1]))[0], rewritten(ca.fabs(W[0] - W[1]))[0]
    for w in np.random.default_rng(1).normal(size=(20, 3)):
        assert float(biggest(w, 0, 1)) == w[1] and float(biggest(w, 0, -1)) == w[0]
        assert {float(distance(w, 0, 1)), float(distance(w, 0, -1))} == {w[1] - w[0], w[0] - w[1]}


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_pieces_are_smooth_at_the_kink(side):
    value = rewritten(ca.fabs(W[0]) + ca.fmax(W[1], W[2]))[0]
    sides = side * np.ones(2)
    slope = ca.Function("slope", [W, P], [ca.jacobian(value(W, P, sides), W)])
    left, right = (np.array(slope([shift, 1 + shift, 1.0], 0)) for shift in (-1e-9, 1e-9))
    np.testing.assert_array_equal(left, right)
