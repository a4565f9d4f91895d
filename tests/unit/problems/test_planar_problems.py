"""Steps of planar-push and planar-hand agree with hand-computed ones; rejected values."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.contact import Exact
from ocp.errors import InputError

PUSH, HAND = "planar-push", "planar-hand"
HAND_START = [0, 0.35, 0, -math.pi / 4, -math.pi / 4, math.pi / 4, math.pi / 4]


def stepped(problem, x, u):
    step = Exact().close(problem.system)
    x_next, lam, _, error = step.solve(x, u, problem.parameters.values)
    assert np.array(error).max() < 1e-9
    return np.array(x_next).ravel(), np.array(lam).ravel()


def impulses(problem, lam):
    """Return the normal and the tangential impulses of all contacts."""
    forces = problem.system.forces
    given = [problem.system.lam, problem.parameters.vector]
    found = ca.Function("forces", given, [forces.normal, forces.tangential])
    return [np.array(v).ravel() for v in found(lam, problem.parameters.values)]


def distances(problem, x):
    return np.array(problem.signed_distance(x, problem.parameters.values)).ravel()


def test_published_settings():
    """Start, goal, weights and bounds of both problems are the published ones."""
    push, hand = problems.get(PUSH), problems.get(HAND)
    rng = np.random.default_rng(0)
    for problem, n, goal, weights, rest in (
        (push, 3, [0.5, 1, -math.pi / 4], [20, 20, 30], [0, 0]),
        (hand, 3, [-0.3, 0.35, 0.5], [10, 10, 10], HAND_START[3:]),
    ):
        nx, nu = problem.system.nx, problem.system.nu
        x, u, du = rng.normal(size=nx), rng.normal(size=nu), rng.normal(size=nu)
        state = np.dot(weights, (x[:n] - goal) ** 2) + 1e-3 * np.sum((x[n:] - rest) ** 2)
        stage, end = problem.cost_terms(x, u, du, 0, problem.parameters.values)
        assert float(stage) == pytest.approx(state + 10 * np.sum(du**2), rel=1e-12)
        assert float(end) == pytest.approx(100 * state, rel=1e-12)
        (reach,) = problem.path
        bound = ca.Function(
            "bound",
            [problem.system.x, problem.system.u, problem.parameters.vector],
            [reach.expression, ca.SX(reach.upper)],
        )
        off, most = bound(x, u, problem.parameters.values)
        np.testing.assert_allclose(np.array(off).ravel(), u - x[n:])
        np.testing.assert_array_equal(np.array(most).ravel(), np.full(reach.expression.numel(), 0.2))
        assert problem.N == 20
    limits = [np.array(v).ravel() for v in hand.limits(hand.parameters.values)]
    np.testing.assert_allclose(limits[4][3:], [-math.pi / 2, -2.4, 0, 0])
    np.testing.assert_allclose(limits[5][3:], [0, 0, math.pi / 2, 2.4])
    np.testing.assert_allclose(limits[0], HAND_START)


def test_both_start_without_contact():
    push, hand = problems.get(PUSH), problems.get(HAND, links="discs")
    start = push.initial_states(push.parameters.values)[0]
    np.testing.assert_allclose(distances(push, start), 0.5 - 0.4995 + 0.2 - 0.1, atol=1e-12)
    phi = distances(hand, HAND_START)
    names = [signal.name for signal in hand.system.contacts[: len(phi)]]
    # The discs half way along the outer links are nearest, by the published 0.0144 m.
    nearest = sorted(np.array(names)[np.argsort(phi)[:2]])
    assert nearest == ["l2 disc 0+", "r2 disc 0+"]
    assert phi.min() == pytest.approx(0.0144, abs=5e-5)


def test_a_push_at_the_middle_moves_the_box_by_the_ratio_of_stiffnesses():
    """By h K (u - a+) = m (o+ - o) / h both move by h² K / (m + h² K) = 1/6 of 0.2 m."""
    problem = problems.get(PUSH)
    x_next, lam = stepped(problem, [0, 0.5, 0, 0, -0.0995], [0, 0.1005])
    np.testing.assert_allclose(x_next, [0, 0.5 + 0.2 / 6, 0, 0, -0.0995 + 0.2 / 6], atol=1e-8)
    normal, tangential = impulses(problem, lam)
    np.testing.assert_allclose([normal[0], tangential[0]], [5 * 0.2 / 6 / 0.1, 0], atol=1e-7)


@pytest.mark.parametrize(("across", "press", "sticks"), [(0.02, 0.2, True), (0.4, 0.02, False)])
def test_friction_drags_the_box_along_within_its_cone(across: float, press: float, sticks: bool):
    problem = problems.get(PUSH)
    x = np.array([0, 0.5, 0, 0, -0.0995])
    u = np.array([across, press - 0.0995])
    x_next, lam = stepped(problem, x, u)
    (normal,), (tangential,) = impulses(problem, lam)
    # The normal out of the box is -y, so the tangent is -x and the reaction pulls the disc back.
    assert tangential > 0
    assert tangential <= 2 / 3 * normal * (1 + 1e-9)
    slip = (x_next[3] - x[3]) - (x_next[0] - x[0] + 0.4995 * (x_next[2] - x[2]))
    if sticks:
        assert abs(slip) < 1e-7
        assert tangential < 0.5 * normal
    else:
        assert slip > 1e-3
        assert tangential == pytest.approx(2 / 3 * normal, rel=1e-6)
    assert x_next[0] > 0
    assert x_next[2] > 0, "a drag to the right along the lower side turns anticlockwise"
    # The box gains the momentum that the actuator's spring gives.
    given = 100 * 0.1 * (u - x_next[3:])
    np.testing.assert_allclose(5 / 0.1 * (x_next[:2] - x[:2]), given, atol=1e-7)


@pytest.mark.parametrize("name", [PUSH, HAND])
def test_frictionless_has_one_row_a_contact_and_drags_nothing(name: str):
    rough, smooth = problems.get(name), problems.get(name, friction=0)
    assert rough.system.nlam == 2 * smooth.system.nlam
    assert "friction" in rough.parameters
    assert "friction" not in smooth.parameters
    assert smooth.origin.settings["friction"] == 0
    if name == PUSH:
        x_next, _ = stepped(smooth, [0, 0.5, 0, 0, -0.0995], [0.15, 0.1005])
        np.testing.assert_allclose(x_next[[0, 2, 3]], [0, 0, 0.15], atol=1e-8)


def test_a_capsule_is_the_hull_of_its_discs():
    """The capsule is never farther than the published discs, and as far at the nearest disc."""
    discs, capsules = problems.get(HAND, links="discs"), problems.get(HAND)
    owner = [signal.name[:2] for signal in discs.system.contacts[:12]]
    rng = np.random.default_rng(1)
    met = 0
    for _ in range(40):
        x = np.array(HAND_START) + 0.3 * rng.standard_normal(7)
        smooth, bumpy = distances(capsules, x), distances(discs, x)
        for i, link in enumerate(("l1", "l2", "r1", "r2")):
            own = [phi for phi, of in zip(bumpy, owner, strict=True) if of == link]
            # Half way between discs the hull is at most 0.05 m nearer to the ball's middle.
            assert smooth[i] <= min(own) + 1e-12
            met += min(own) - smooth[i] < 1e-9
    assert met > 10, "often an end of the link is the nearest point"


def test_weight_pulls_the_ball_down():
    problem = problems.get(HAND, g=9.81, r1=1.5, l1=-1.5, r2=0, l2=0, oy0=1.0)
    x = problem.initial_states(problem.parameters.values)[0]
    x_next, lam = stepped(problem, x, x[3:])
    np.testing.assert_allclose(x_next - x, [0, -(0.1**2) * 9.81, 0, 0, 0, 0, 0], atol=1e-9)
    assert lam.max() < 1e-9


@pytest.mark.parametrize("friction", [0.5, 0])
@pytest.mark.parametrize("name", [PUSH, HAND])
def test_frames_are_where_contact_is(name: str, friction: float):
    """A frame's normal is the direction in which the object runs from the contact."""
    spec, problem = problems.spec(name), problems.get(name, friction=friction)
    params = spec.params({"friction": friction})
    x = problem.initial_states(problem.parameters.values)[0] + 0.01
    frames = spec.frames(params, x)
    phi = distances(problem, x)
    assert len(frames) == len(phi)
    for i, frame in enumerate(frames):
        assert frame.friction == friction
        assert math.hypot(frame.nx, frame.ny) == pytest.approx(1)
        moved = x.copy()
        moved[:2] += 1e-6 * np.array([frame.nx, frame.ny])
        assert (distances(problem, moved) - phi)[i] == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        (PUSH, {"ay0": -0.05}, "the pusher starts 0.0495 m inside the box; move ax0"),
        (PUSH, {"goal_x": 0, "goal_y": 0.2}, "the box's goal overlaps the pusher"),
        (PUSH, {"friction": -0.1}, r"friction .* must be a number >= 0, got -0.1"),
        (PUSH, {"gap": "curved"}, "must be 'linearised' or 'true', got 'curved'"),
        (HAND, {"oy0": 0.3}, r"the ball starts .* m inside link l1; move ox0"),
        (HAND, {"goal_x": -0.1, "goal_y": 0.1}, "inside the base of the left arm; move"),
        (HAND, {"r1": -0.1}, r"joint r1 starts outside its limits: -0.1 rad, .* \[0, 1.571\]"),
        (HAND, {"friction": -1}, r"friction .* must be a number >= 0"),
        (HAND, {"links": "boxes"}, "must be 'capsules' or 'discs', got 'boxes'"),
    ],
)
def test_bad_input_gets_its_sentence(name: str, values: dict, sentence: str):
    with pytest.raises(InputError, match=sentence) as raised:
        problems.get(name, **values)
    assert "\n" not in str(raised.value)
