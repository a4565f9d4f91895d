"""Pushing at one side at a time: closed forms, enumeration of sides, and headings reached from zero guesses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.contact import Exact
from ocp import solve
from problems import get

FORCES = st.lists(st.floats(0, 10), min_size=4, max_size=4)


def step(name: str, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the next state and the forces of the sides in one exact step."""
    problem = get(name)
    found = Exact().close(problem.system).solve(x, u, problem.parameters.values)
    return np.array(found[0]).ravel(), np.array(found[1]).ravel()


@settings(max_examples=50, deadline=None)
@given(FORCES)
def test_the_side_with_the_greatest_force_pushes_with_what_the_others_leave(F: list[float]) -> None:
    _, w = step("push-box", np.zeros(3), np.array([*F, 0.0]))
    expected = np.maximum(2 * np.array(F) - sum(F), 0)
    np.testing.assert_allclose(w, expected, atol=1e-9)
    assert (w > 1e-6).sum() <= 1


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 3), st.floats(0.1, 10), st.floats(-1, 1), st.floats(-4, 4))
def test_a_push_turns_and_moves_the_box_by_the_sources_equations(
    side: int, force: float, share: float, angle: float
) -> None:
    """The step agrees with the source's equations for the contact point (cx, cy), its force and its lever."""
    a, b, weight, reach = 0.5, 0.25, 0.5 * 9.8, 0.4 * math.hypot(0.5, 0.25)
    half, middle, normal = (
        (a, (0, -b), (0, 1)),
        (b, (a, 0), (-1, 0)),
        (a, (0, b), (0, -1)),
        (b, (-a, 0), (1, 0)),
    )[side]
    along = np.array([-normal[1], normal[0]])
    contact = np.array(middle) + share * half * along
    pushed = force * np.array(normal)
    moment = contact[0] * pushed[1] - contact[1] * pushed[0]
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    expected = [*(turn @ pushed / weight), moment / (weight * reach)]
    u = np.zeros(5)
    u[side], u[4] = force, moment
    there, _ = step("push-box", np.array([0.3, -0.2, angle]), u)
    np.testing.assert_allclose(there - [0.3, -0.2, angle], 0.02 * np.array(expected), rtol=1e-9, atol=1e-12)


def test_the_corners_of_the_t_are_about_its_centre_of_mass() -> None:
    """A force through the middle of the foot, or of the bar's top, moves the T without rotation."""
    for side, way in ((0, 1.0), (4, -1.0)):
        u = np.zeros(9)
        u[side] = 2.0
        there, w = step("push-t", np.zeros(3), u)
        assert w.argmax() == side
        np.testing.assert_allclose(there, [0, way * 0.05 * 2 / (0.4 * 9.8), 0], atol=1e-12)
    corners = np.array([[-0.5, 0], [0.5, 0], [0.5, 3], [2, 3], [2, 4], [-2, 4], [-2, 3], [-0.5, 3]])
    x, y = corners.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    centre = ((y + np.roll(y, -1)) * cross).sum() / (3 * cross.sum())
    assert centre == pytest.approx(2.6429, abs=1e-4)


@pytest.mark.costly
@pytest.mark.cheap_cases("0.0")
@pytest.mark.parametrize("heading", [0.0, 1.2, math.pi, 5.0])
def test_a_heading_is_reached_from_an_all_zero_guess(heading: float) -> None:
    """The heading is reached to a few centimetres, by one side at a time and within that side's ends.

    With steps this long the path changes noticeably at h/4, so that only the model's own step counts.
    """
    found = solve("push-box", contact="exact", N=30, h=0.06, heading=heading)
    assert found.certificate.stationarity == "B" and found.referee.survives_at_h
    x, lam = found.data["x"].values[0], found.data["lam"].values[0]
    goal = [3 * math.cos(heading), 3 * math.sin(heading), heading]
    assert np.abs(x[-1] - goal).max() < 0.15
    assert np.sort(lam, axis=1)[:, :-1].max() < 1e-6
    moment = found.data["u"].values[0][:, -1]
    assert np.all(np.abs(moment) <= lam @ [0.5, 0.25, 0.5, 0.25] + 1e-6)
