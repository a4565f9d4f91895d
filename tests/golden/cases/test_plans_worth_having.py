"""Plans that relaxations miss and samples find, for objects that must be hit, or held from two sides."""

from __future__ import annotations

import casadi as ca
import pytest

from dynamics.systems import ParameterTable
from ocp import solve
from ocp.problem.parts import Scaling
from ocp.problem.problem import Problem
from problems.scenes import Body, Disc, HalfPlane, Obstacle, Pusher, Scene

NO_PARAMETERS = ParameterTable()
FORCE, FRICTION, DEPTH = 10.0, 4.0, 0.02


def nail() -> Problem:
    """Return a problem of a nail of 1 kg that needs more than 39 N, and a hammer of 2 kg with at most 10 N."""
    scene = Scene(
        [
            Pusher("hammer", Disc(0.1), at=(-0.25, 0.1), mass=2.0, axis=(1.0, 0.0)),
            Body("nail", Disc(0.1), at=(0.0, 0.1), mass=1.0),
            Obstacle("board", HalfPlane(), at=(0.0, 0.0)),
        ],
        friction={("nail", "board"): FRICTION},
        non_colliding=[("hammer", "board")],
    )
    system = scene.time_stepping("nail", NO_PARAMETERS, h=0.02, gravity=(0, -9.81))
    depth = scene.coordinates_of("nail", system.x)[0]
    return Problem(
        "nail",
        system,
        40,
        stage_cost=2e-5 * system.u**2,
        terminal_cost=1e4 * (depth - DEPTH) ** 2,
        x0=scene.at_rest(system),
        parameters=NO_PARAMETERS,
        u_lower=-FORCE,
        u_upper=FORCE,
        scaling=Scaling(impulse=0.5, gap=0.05, x=0.1, u=5),
    )


@pytest.mark.costly
def test_a_nail_is_hit_and_not_pressed() -> None:
    """Pressing does not move it and costs 4; the best known plan costs 0.0270."""
    assert FORCE < FRICTION * 1.0 * 9.81
    solution = solve(nail(), contact="exact", search=True)
    assert solution.certificate.certified
    assert solution.cost < 1.05 * 0.0270
    assert float(ca.DM(1e4 * DEPTH**2)) == pytest.approx(4.0)
    assert solution.route.name == "sampling"
