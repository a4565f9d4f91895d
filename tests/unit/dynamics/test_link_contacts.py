"""Contacts between two links of a machine: impulses, conserved momentum, and drawing."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from dynamics.systems import ContactSystem, Link, Machine, ParameterTable, Part, Sphere
from dynamics.systems.shapes import Box, Capsule, Disc, HalfPlane, Shape
from problems import drawing
from problems.machines.machine import machine_frames, machine_shapes

H, G = 0.01, 9.81
MASSES, INERTIAS = np.array([2.0, 0.7]), np.array([0.05, 0.01])
SHAPES = {
    "discs": (Disc(0.2), Disc(0.1)),
    "capsule and box": (Capsule((-0.3, 0.0), (0.3, 0.0), 0.05), Box((0.1, 0.1), 0.02)),
    "boxes": (Box((0.3, 0.2)), Box((0.1, 0.15), 0.05)),
}


def two_bodies(shapes: tuple, friction: float | None = 0.5) -> ContactSystem:
    """Return the system of two free bodies in the air that can touch only each other."""
    links = tuple(
        Link(name, None, mass=float(m), inertia=float(i), joint="free")
        for name, m, i in zip(("large", "small"), MASSES, INERTIAS, strict=True)
    )
    parts = tuple(Part(link.name, link.name, shape) for link, shape in zip(links, shapes, strict=True))
    machine = Machine(links, (), parts=parts, collision_pairs=(("small", "large"),))
    return machine.system("two bodies", ParameterTable(), h=H, friction=friction)


def momenta(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the linear momentum (2,) and the angular momentum about +y through the origin, at positions of x."""
    q, v = x[:6].reshape(2, 3), v.reshape(2, 3)
    linear = MASSES @ v[:, :2]
    turning = MASSES @ (q[:, 1] * v[:, 0] - q[:, 0] * v[:, 1]) + INERTIAS @ v[:, 2]
    return np.array([*linear, turning])


def thrown() -> np.ndarray:
    """Return a state in which the small body falls, spinning, onto the large one off its middle."""
    return np.array([0, 1.0, 0.1, 0.12, 1.38, 0.3, 0, 0, 0, -0.5, -3.0, 4.0])


@pytest.mark.cheap_cases("discs-exact", "discs-barrier")
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-5)], ids=["exact", "barrier"])
@pytest.mark.parametrize("name", list(SHAPES))
def test_impulses_between_links_are_equal_and_opposite(name: str, law) -> None:
    """Linear and angular momentum change by the weight's impulse alone."""
    system = two_bodies(SHAPES[name])
    step = law.close(system)
    x, pushed = thrown(), 0.0
    for _ in range(25):
        x_next, lam, gap, error = (np.array(v).ravel() for v in step.solve(x, [], step.p.values))
        assert error.max() <= 1e-7
        assert gap[0] >= -1e-9
        weight = np.array([0, -H * G * MASSES.sum(), H * G * (MASSES @ x[:6].reshape(2, 3)[:, 0])])
        gained = momenta(x, x_next[6:]) - momenta(x, x[6:])
        np.testing.assert_allclose(gained, weight, atol=1e-11)
        pushed, x = max(pushed, lam[0]), x_next
    assert pushed > 0.5, "they did meet"
    assert abs(x[8]) > 0.1, "and the large one turns since"


def test_the_book_counts_no_impulse_between_links_as_one_from_outside() -> None:
    system = two_bodies(SHAPES["boxes"])
    step, book, x = Exact().close(system), system.energy_balance, thrown()
    assert book is not None
    values = ca.Function("book", [system.x, system.u, system.x_next, system.lam], [book.momentum, book.external])
    met = False
    for _ in range(15):
        x_next, lam, *_ = (np.array(v).ravel() for v in step.solve(x, [], step.p.values))
        before, external = (np.array(v).ravel() for v in values(x, [], x_next, lam))
        after = np.array(values(x_next, [], x_next, lam)[0]).ravel()
        np.testing.assert_allclose(after - before, external, atol=1e-11)
        met, x = met or lam[0] > 0.1, x_next
    assert met


def test_two_bodies_that_stick_move_as_one() -> None:
    """After a plastic head-on collision both discs move with the velocity of their common centre."""
    system = two_bodies((Disc(0.2), Disc(0.1)), friction=None)
    x = np.array([0, 0, 0, 0.301, 0, 0, 1.0, 0, 0, -2.0, 0, 0])
    step = Exact().close(system)
    x_next = np.array(step.solve(x, [], step.p.values)[0]).ravel()
    together = MASSES @ [1.0, -2.0] / MASSES.sum()
    # The gap of 1 mm closes within the step.
    closing = 0.001 / H
    share = MASSES[::-1] / MASSES.sum() * [closing, -closing]
    np.testing.assert_allclose(x_next[[6, 9]], together + share, atol=1e-3)
    assert x_next[3] - x_next[0] == pytest.approx(np.sqrt(0.3**2 - 0.0**2), abs=1e-9)


def folded() -> Machine:
    """Return a machine of a bar on a floor with an arm that folds back onto it."""
    return Machine(
        links=(
            Link("bar", None, mass=1.0, inertia=0.1, joint="free"),
            Link("upper", "bar", mass=0.3, inertia=0.01, com=(0, 0.2), anchor=(-0.4, 0.05)),
            Link("lower", "upper", mass=0.2, inertia=0.01, com=(0, 0.2), anchor=(0, 0.4), gear=1.0),
        ),
        spheres=(Sphere("hand", "lower", (0.0, 0.4), 0.04), Sphere("end", "bar", (0.5, 0.0), 0.05)),
        parts=(Part("beam", "bar", Box((0.5, 0.05))),),
        collision_pairs=(("hand", "beam"),),
    )


def test_a_contact_between_links_does_no_work_in_a_rigid_motion() -> None:
    machine = folded()
    chain = machine.tree()
    q = ca.SX.sym("q", chain.nq)
    contacts = machine.contacts(q, spheres=("end",))
    assert list(contacts) == ["end", "hand on beam"]
    rows = ca.Function("rows", [q], [ca.densify(ca.vertcat(*c.jacobians(q))) for c in contacts.values()])
    at = np.array([0.2, 0.5, 0.3, 1.4, 1.9])
    ground, between = (np.array(v) for v in rows(at))
    rigid = np.array([[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [at[1], -at[0], 1, 0, 0]]).T
    np.testing.assert_allclose(between @ rigid, 0, atol=1e-14)
    assert np.abs(between[:, 3:]).min() > 1e-2, "the joints do feel it"
    assert np.abs(ground @ rigid).max() > 0.5, "as the ground is felt by all"


def test_a_machine_is_drawn_with_its_parts_and_the_contacts_between_its_links() -> None:
    machine, state = folded(), np.array([0.2, 0.5, 0.3, 1.0, 0.9, *np.zeros(5)])
    shapes = machine_shapes(machine, state)
    assert drawing.Rectangle(0.2, 0.5, 1.0, 0.1, -0.3) in shapes
    hand, end = (shape for shape in shapes if isinstance(shape, drawing.Circle))
    ground, between = machine_frames(machine, state, ("end",), 0.5)
    assert (ground.x, ground.y) == pytest.approx((end.x, end.y - 0.05), abs=1e-15)
    # The beam's upper side is turned clockwise by 0.3 and so is its normal; the hand is above it.
    normal = np.array([np.sin(0.3), np.cos(0.3)])
    assert (between.nx, between.ny) == pytest.approx(normal, abs=1e-15)
    nearest = np.array([hand.x, hand.y]) - 0.04 * normal
    assert (between.x, between.y) == pytest.approx(nearest, abs=1e-15)


@pytest.mark.parametrize(
    ("shape", "drawn"),
    [
        (Capsule((-0.2, 0.0), (0.0, 0.3), 0.1), drawing.Stadium(1.0, 2.2, 1.3, 2.0, 0.1)),
        (HalfPlane((0.0, -0.1)), drawing.Wall(0.9, 2.0, 1.0, 0.0, "object")),
    ],
)
def test_a_part_is_drawn_where_its_link_is(shape: Shape, drawn: drawing.Shape) -> None:
    """The link is turned clockwise by a right angle, so that its x points down and its z to the right."""
    machine = Machine((Link("link", None, 1.0, 0.1, joint="free"),), (), parts=(Part("part", "link", shape),))
    found = machine_shapes(machine, np.array([1.0, 2.0, np.pi / 2]))[-1]
    assert isinstance(found, type(drawn))
    np.testing.assert_allclose([*vars(found).values()][:4], [*vars(drawn).values()][:4], atol=1e-15)


def test_an_arm_that_folds_onto_its_own_bar_stops_there() -> None:
    system = folded().system("folded", ParameterTable(), h=H, friction=0.5)
    assert system.distance_names == ("hand", "end", "hand on beam")
    step = Exact().close(system)
    x = np.array([0, 0.3, 0, 1.2, 1.2, *np.zeros(5)])
    nearest = np.inf
    for _ in range(60):
        x = np.array(step.solve(x, [-1.0], step.p.values)[0]).ravel()
        distances = np.array(ca.Function("phi", [system.x], [system.phi])(x)).ravel()
        assert distances.min() > -1e-7
        nearest = min(nearest, distances[2])
    assert nearest < 1e-6


@pytest.mark.parametrize(
    ("meeting", "sentence"),
    [
        (("hand", "nose"), "'nose' is not a part; choose from hand, end, beam"),
        (("end", "beam"), "end and beam are on the same link and never touch"),
    ],
)
def test_a_meeting_that_cannot_be_is_refused(meeting, sentence: str) -> None:
    machine = folded()
    with pytest.raises(ValueError, match=sentence):
        Machine(machine.links, machine.spheres, parts=machine.parts, collision_pairs=(meeting,))


def test_a_part_on_a_link_that_is_none_is_refused() -> None:
    links = folded().links
    sentence = f"'toe' is on link 'foot', which does not exist; choose from {links[0].name}"
    with pytest.raises(ValueError, match=sentence):
        Machine(links, (Sphere("toe", "foot", (0.0, 0.0), 0.1),))
