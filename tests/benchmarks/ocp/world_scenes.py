"""Ten planar scenes as a laboratory would use: bodies, goals, obstacles, and a round finger."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca

from dynamics.systems import ParameterTable
from ocp.problem.problem import Constraint, Problem, Scaling
from problems.scenes import (
    Body,
    Box,
    Disc,
    Goal,
    Obstacle,
    Polygon,
    Pusher,
    Scene,
    Union,
)

FINGER, STIFFNESS, FRICTION, H, REACH = 0.05, 50.0, 0.3, 0.05, 0.15
SQUARE = Box((0.15, 0.15))
TEE = Union([Box((0.2, 0.05)), Polygon([(-0.05, -0.25), (0.05, -0.25), (0.05, -0.05), (-0.05, -0.05)])])
HOOK = Union(
    [
        Polygon([(-0.2, -0.05), (0.2, -0.05), (0.2, 0.05), (-0.2, 0.05)]),
        Polygon([(0.1, -0.25), (0.2, -0.25), (0.2, -0.05), (0.1, -0.05)]),
    ]
)


def scene_problem(
    name: str,
    things: Sequence[Body | Obstacle | Goal],
    N: int = 40,
    finger: tuple[float, float] = (-0.5, 0.0),
) -> Problem:
    """Return the problem of bringing bodies to their goals at rest, with little motion of the finger."""
    table = ParameterTable(())
    pusher = Pusher("finger", Disc(FINGER), at=finger, stiffness=STIFFNESS)
    made = Scene([pusher, *things], friction=FRICTION)
    system = made.quasi_dynamic(name, table, h=H)
    off = ca.SX(0, 1)
    for goal in made.goals:
        there = made.coordinates_of(goal.body, system.x)
        wanted = ca.vertcat(*goal.at, goal.angle)
        weights = ca.vertcat(1.0, 1.0, 0.3)[: there.numel()]
        off = ca.vertcat(off, weights * (there - wanted[: there.numel()]))
    du = ca.SX.sym("du", system.nu)
    return Problem(
        name,
        system,
        N,
        stage_cost=0.01 * ca.sumsqr(off) + 0.1 * ca.sumsqr(du),
        terminal_cost=10 * ca.sumsqr(off),
        x0=made.at_rest(system),
        parameters=table,
        du=du,
        u_before=made.hold,
        path=[Constraint("reach", system.u - made.coordinates_of("finger", system.x), -REACH, REACH)],
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),
    )


def _box(at: tuple[float, float], angle: float = 0.0, name: str = "box") -> Body:
    return Body.uniform(name, SQUARE, at=at, angle=angle, mass=1.0)


def _block(name: str, x: float, y: float, half: tuple[float, float] = (0.1, 0.1)) -> Obstacle:
    return Obstacle(name, Box(half), at=(x, y))


def row_of_discs(m: int, N: int = 40) -> Problem:
    """Return the problem of pushing the last of ``m`` discs, which lie in a row in front of the finger."""
    discs = [Body.uniform(f"disc{k}", Disc(0.1), at=(0.25 * k, 0), mass=1.0) for k in range(m)]
    return scene_problem(f"row-{m}", [*discs, Goal(f"disc{m - 1}", at=(0.25 * m + 0.05, 0))], N)


SCENES: dict[str, Callable[[], Problem]] = {
    "box past a block": lambda: scene_problem(
        "past-block", [_box((0, 0)), _block("block", 0.5, -0.25), Goal("box", at=(0.9, 0.1))]
    ),
    "box among boxes": lambda: scene_problem(
        "among-boxes",
        [
            _box((0, 0)),
            _block("low", 0.45, -0.35),
            _block("high", 0.5, 0.4),
            _block("far", 1.1, -0.1),
            Goal("box", at=(0.8, 0.1)),
        ],
    ),
    "box that comes back": lambda: scene_problem(
        "comes-back", [_box((0, 0)), _block("block", 0.0, -0.45), Goal("box", at=(-0.4, 0))], 60
    ),
    "a quarter turn": lambda: scene_problem("turn", [_box((0, 0)), Goal("box", at=(0.2, 0.0), angle=1.2)], 60),
    "T into a corner": lambda: scene_problem(
        "tee",
        [
            Body.uniform("tee", TEE, at=(0, 0), mass=1.0),
            _block("wall", 0.95, 0.0, (0.1, 0.8)),
            _block("floor", 0.3, -0.75, (0.8, 0.1)),
            Goal("tee", at=(0.6, -0.25), angle=0.0),
        ],
        60,
    ),
    "through a gap": lambda: scene_problem(
        "gap", [_box((0, 0)), _block("low", 0.5, -0.28), _block("high", 0.5, 0.28), Goal("box", at=(0.9, 0.0))]
    ),
    "two to two goals": lambda: scene_problem(
        "two",
        [
            Body.uniform("first", Disc(0.12), at=(0, 0.3), mass=1.0),
            _box((0, -0.3), name="second"),
            Goal("first", at=(0.3, 0.35)),
            Goal("second", at=(0.3, -0.35)),
        ],
        80,
    ),
    "a hook": lambda: scene_problem(
        "hook", [Body.uniform("hook", HOOK, at=(0, 0), mass=1.0), Goal("hook", at=(-0.3, 0.0))], 60
    ),
    "disc round a wall": lambda: scene_problem(
        "wall",
        [
            Body.uniform("disc", Disc(0.15), at=(0, 0), mass=1.0),
            _block("wall", 0.4, 0.25, (0.05, 0.3)),
            Goal("disc", at=(0.8, 0.2)),
        ],
        60,
    ),
    "triangle to a wall": lambda: scene_problem(
        "triangle",
        [
            Body.uniform("triangle", Polygon([(-0.15, -0.1), (0.2, -0.1), (-0.15, 0.2)]), at=(0, 0), mass=1.0),
            _block("wall", 0.6, 0.0, (0.1, 0.5)),
            Goal("triangle", at=(0.3, 0.2), angle=0.5),
        ],
        50,
    ),
    **{f"{m} discs in a row": partial(row_of_discs, m) for m in (2, 4, 8)},
}
