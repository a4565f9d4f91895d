"""Scenes: rejected values, drawings, and names of states and inputs."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Parameter, ParameterTable
from ocp.errors import InputError
from problems import drawing
from problems.parameters import Parameters, quantity, table
from problems.registry import load
from problems.scenes import (
    Body,
    Box,
    Capsule,
    Disc,
    Goal,
    HalfPlane,
    Obstacle,
    Pusher,
    Scene,
    drawing_functions,
)

EXAMPLES = Path(__file__).parents[3] / "examples"
BAD = ParameterTable([Parameter("bad", -0.1)])
HAND = Pusher("hand", Disc(0.1), at=(-1.0, 0.0), stiffness=50.0)
PUCK = Body("puck", Disc(0.2), at=(0.0, 0.0))


def one(**changed: object) -> Body:
    return Body(**{"name": "object", "shape": Disc(0.2), "at": (0.0, 0.0), **changed})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("things", "more", "sentence"),
    [
        ([HAND, one(shape=Disc(BAD["bad"]))], {}, "'object': its disc has the radius -0.1 m"),
        ([HAND, one(shape=Box((0.2, BAD["bad"])))], {}, "its box has a half side of -0.1 m"),
        ([HAND, one(shape=Box((0.2, 0.1), 0.15))], {}, "at most half its shorter side, 0.1 m"),
        ([HAND, one(shape=Capsule((0, 0), (0, 0), 0.1))], {}, "its capsule has the length 0 m"),
        ([HAND, one(shape=HalfPlane())], {}, "'object' moves, and a half-plane is unbounded"),
        ([HAND, Obstacle("wall", HalfPlane(normal=(0, BAD["bad"])), at=(0, 0))], {}, "length 0.1"),
        ([HAND, one(mass=BAD["bad"])], {}, "'object' has the mass -0.1; expected a positive"),
        ([HAND, one(inertia=BAD["bad"])], {}, "'object' has the inertia -0.1"),
        ([HAND, one(), PUCK, one()], {}, "two things are called 'object'"),
        ([Obstacle("post", Disc(0.1), at=(0, 0))], {}, "nothing in the scene moves"),
        ([HAND, one(), Obstacle("post", Disc(0.1), at=(0.25, 0))], {}, "0.05 m inside 'post'"),
        ([HAND, one(), Goal("objekt", at=(1, 0))], {}, "'objekt' (did you mean 'object'?)"),
        ([HAND, one()], {"friction": {("hand", "puck"): 0.1}}, "a pair names 'puck'"),
        ([HAND, one()], {"friction": {"hand": 0.1}}, "'hand' is not a pair of names"),
        ([HAND, one()], {"friction": {("hand", "hand"): 0.1}}, "'hand' cannot touch itself"),
        ([HAND, one()], {"friction": BAD["bad"]}, "hand on object: Coulomb's coefficient is -0.1"),
        ([HAND, one()], {"non_colliding": [("hand", "post")]}, "a pair names 'post'"),
        ([Pusher("hand", Disc(0.1), at=(-1, 0)), one()], {}, "'hand' has no stiffness"),
        (
            [Pusher("hand", Disc(0.1), at=(-1, 0), stiffness=1.0, axis=(BAD["bad"], 0)), one()],
            {},
            "the rail of 'hand' runs along (-0.1, 0) of length 0.1",
        ),
    ],
)
def test_a_bad_scene_gets_one_sentence(things, more, sentence: str) -> None:
    with pytest.raises(InputError) as told:
        Scene(things, **more).quasi_dynamic("bad", BAD, h=0.1)
    assert sentence in str(told.value) and "\n" not in str(told.value)


def test_a_pusher_without_mass_cannot_be_thrown_about() -> None:
    with pytest.raises(InputError, match="'hand' has no mass, required in a scene with vel"):
        Scene([HAND, one()]).time_stepping("bad", ParameterTable(), h=0.1)


def test_pairs_that_are_apart_have_no_contact_and_obstacles_never() -> None:
    wall, floor = (Obstacle(n, HalfPlane(), at=(0, -1)) for n in ("wall", "floor"))
    scene = Scene([HAND, one(), wall, floor], non_colliding=[("wall", "hand")])
    assert [touch.name for touch in scene.touches] == [
        "hand on object",
        "hand on floor",
        "object on wall",
        "object on floor",
    ]


def test_coordinates_are_those_of_bodies_then_of_pushers() -> None:
    cart = Pusher("cart", Disc(0.1), at=(0.0, 2.0), axis=(1.0, 0.0), stiffness=9.0, mass=3.0)
    scene = Scene([HAND, cart, one(inertia=0.1), Body("puck", Disc(0.2), at=(3.0, 4.0))])
    slow = scene.quasi_dynamic("slow", ParameterTable(), h=0.1)
    assert [signal.name for signal in slow.states] == [
        "object_x",
        "object_y",
        "object_angle",
        "puck_x",
        "puck_y",
        "hand_x",
        "hand_y",
        "cart",
    ]
    assert [signal.name for signal in slow.inputs] == ["u_hand_x", "u_hand_y", "u_cart"]
    start = np.array(ca.DM(scene.at_rest(slow))).ravel()
    np.testing.assert_array_equal(start, [0, 0, 0, 3, 4, -1, 0, 0])
    np.testing.assert_array_equal(np.array(ca.DM(scene.hold)).ravel(), [-1, 0, 0])
    assert ca.is_equal(scene.coordinates_of("puck", slow.x), slow.x[3:5], 2)


class Params(Parameters):
    """Parameters of a test problem with a box beside a wall."""

    R: float = quantity(0.2, "m", "radius", above=0)
    goal: float = quantity(1.5, "m", "goal")
    f: float = quantity(0.4, "1", "friction", least=0)


def stage(p) -> Scene:
    return Scene(
        [
            Pusher("hand", Capsule((-0.1, 0.0), (0.1, 0.0), 0.05), at=(0.0, 0.5), stiffness=50.0),
            Body("disc", Disc(p["R"]), at=(1.0, 0.0), inertia=0.1),
            Body("box", Box((0.3, 0.1), 0.02), at=(-1.0, 0.0), inertia=0.1),
            Obstacle("floor", HalfPlane(), at=(0.0, -0.5)),
            Goal("box", at=(p["goal"], 0.2), angle=0.5),
        ],
        friction={("hand", "disc"): p["f"]},
    )


def test_the_drawing_is_made_of_the_shapes_whose_gaps_count() -> None:
    """Distances measured in the drawing equal the gaps of the system."""
    params = Params(R=0.25)
    draw, frames = drawing_functions(stage)
    state = np.array([1.0, 0.1, 0.7, -1.0, 0.2, 0.3, 0.1, 0.5])
    floor, goal, hand, disc, mark, box = draw(params, state)
    assert floor == drawing.Wall(0, -0.5, 0, 1, "environment")
    assert goal == drawing.Rectangle(1.5, 0.2, 0.6, 0.2, 0.5, "goal", 0.02)
    assert hand == drawing.Stadium(0.0, 0.5, 0.2, 0.5, 0.05, "actuator")
    assert disc == drawing.Circle(1.0, 0.1, 0.25, "object")
    assert box == drawing.Rectangle(-1.0, 0.2, 0.6, 0.2, 0.3, "object", 0.02)
    assert isinstance(mark, drawing.Segment)
    # After a turn by 0.7 anticlockwise, an upright edge leans to the left.
    assert (mark.x2, mark.y2) == pytest.approx((1 - 0.25 * np.sin(0.7), 0.1 + 0.25 * np.cos(0.7)))
    p = table(params)
    system = stage(p).quasi_dynamic("stage", p, h=0.1)
    assert system.phi is not None
    phi = ca.Function("phi", [system.x, p.vector], [system.phi])(state, p.values)
    gaps = dict(zip(system.distance_names, np.array(phi).ravel(), strict=True))
    apart = np.hypot(1.0 - 0.2, 0.1 - 0.5) - 0.25 - 0.05
    assert gaps["hand on disc"] == pytest.approx(apart)
    # The frame is at the contact of hand and disc, and its normal points into the disc.
    at = frames(params, state)[list(gaps).index("hand on disc")]
    towards = np.array([0.8, -0.4]) / np.hypot(0.8, 0.4)
    assert (at.nx, at.ny) == pytest.approx(tuple(towards))
    assert (at.x, at.y) == pytest.approx(tuple([1.0, 0.1] - 0.25 * towards))
    assert at.friction == 0.4
    assert {frame.friction for frame in frames(params, state)} == {0.0, 0.4}


def test_a_bad_number_of_a_users_scene_is_told_with_its_line() -> None:
    spec = load(EXAMPLES / "past_a_post.py")
    with pytest.raises(InputError, match=r"line .*'object' starts 0.2.* m inside 'post'"):
        spec.problem({"post": 0.55})
