"""Named objectives agree with independently written mechanics."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.errors import InputError
from problems.library import coulomb
from problems.registry import named, objective_names, objective_spec


@pytest.mark.parametrize("name", objective_names())
def test_gradients_are_differences_away_from_kinks(name):
    objective = objective_spec(name).objective()
    noise = np.array([[0.0137], [-0.0211], [0.0733]]) * (1 if name != "ball-wall" else 0.1)
    h = 1e-7
    ahead, behind = objective.costs(noise + h), objective.costs(noise - h)
    for k, w in enumerate(noise[:, 0]):
        moved = objective.at({"theta": float(objective.theta[0]) + w})
        gradient = moved._cost_and_gradient(moved.theta[None, :], moved.values)[1][0, 0]
        np.testing.assert_allclose(gradient, (ahead - behind)[k] / (2 * h), rtol=1e-5, atol=1e-6)


def test_friction_is_clipped_at_its_limit():
    slip = np.linspace(-1, 1, 41)
    objective = objective_spec("coulomb").objective({"nu": 0.2})
    np.testing.assert_allclose(objective.costs(slip[:, None]), np.clip(2 * slip / 0.2, -1, 1))


def test_a_dragged_block_reaches_the_belt_or_the_limit_of_friction():
    """As nu tends to 0, the impulse is clip(m b, -N h F, N h F), by Coulomb friction on a body at rest."""
    belt = np.linspace(-0.2, 0.2, 33)
    values = {"nu": 1e-9, "m": 10.0, "friction_force": 5.0, "h": 0.01, "N": 10}
    impulse = objective_spec("belt-block").objective(values).costs(belt[:, None])
    np.testing.assert_allclose(impulse, np.clip(10 * belt / 0.5, -1, 1), atol=1e-8)


def test_a_ball_passes_above_the_corner_and_turns_back_below():
    objective = objective_spec("ball-wall").objective({"theta": 0.5})
    for angle in (0.5, 0.6, 0.68, 0.7, 0.75, 0.9):
        x, y, vx, vy, h = 0.0, 0.0, 5 * np.cos(angle), 5 * np.sin(angle), 1e-5
        for _ in range(40_000):
            x_next = x + h * vx
            if x < 1.475 <= x_next and y < 0.5:
                x_next, vx = 2 * 1.475 - x_next, -vx
            x, y, vy = x_next, y + h * vy, vy - h * 9.81
        found = objective.costs(np.array([[angle - 0.5]]))[0]
        np.testing.assert_allclose(found, -x, atol=1e-4)


def test_names_are_known_and_unknown_ones_list_the_choices():
    assert named("wall-1d").name == "wall-1d"
    assert named("coulomb").cost is coulomb.cost
    with pytest.raises(InputError, match="did you mean 'coulomb'"):
        named("colomb")
    with pytest.raises(InputError, match="there are heaviside"):
        objective_spec("nothing")
    with pytest.raises(InputError, match="number > 0"):
        objective_spec("coulomb").objective({"nu": 0.0})
