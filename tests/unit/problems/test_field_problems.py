"""Steps of box-slide, ball-throw, cart-transport and hopper-1d agree with hand-computed ones."""

from __future__ import annotations

from dataclasses import asdict

import casadi as ca
import numpy as np
import pytest
import typst

import problems
from dynamics.contact import Adaptive, Barrier, Exact
from dynamics.settings import settings_of
from dynamics.systems import signals, time_stepping
from dynamics.systems.pairs import Pair, deciding_pairs
from dynamics.systems.parameters import ParameterTable
from ocp.errors import InputError
from problems.library import ball_throw
from problems.parameters import is_structural
from tests.unit.problems.test_problems import expressions, other_value

NAMES = ["box-slide", "ball-throw", "cart-transport", "hopper-1d"]
PARAMETERS = [(name, parameter) for name in NAMES for parameter in problems.spec(name).Params.model_fields]


def step(name: str, x: list[float], u: list[float], law=None, **values: float):
    """Return the next state and the multipliers of one step."""
    problem = problems.get(name, **values)
    closed = (law or Exact()).close(problem.system)
    x_next, lam = closed.map(x, u, closed.p.values)
    return np.array(x_next).ravel(), np.array(lam).ravel()


@pytest.mark.one_case_in(5)
@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_every_parameter_can_be_set_and_reaches_the_problem(name: str, parameter: str) -> None:
    value = other_value(name, parameter)
    problem = problems.get(name, **{parameter: value})
    if is_structural(settings_of(problems.spec(name).Params)[parameter]):
        assert problem.origin.settings[parameter] == value
    else:
        assert problem.parameters.defaults[parameter] == value
        assert ca.depends_on(expressions(problem), problem.parameters[parameter])


def test_costs_match_the_hand_computed_ones() -> None:
    hand = {
        "box-slide": lambda x, u: (
            0.01 * 0.05 * u[0] ** 2,
            100 * (x[0] - 1) ** 2 + 10 * x[1] ** 2,
        ),
        "ball-throw": lambda x, u: (
            x[4] * 1e-3 * u[1] ** 2 + (1 - x[4]) * (u[0] ** 2 + 0.01 * u[1] ** 2),
            (x[0] - 2.476) ** 2 + (x[1] - 0.5547) ** 2 + 0.1 * ((x[2] - 2.476) ** 2 + (x[3] - 0.4327) ** 2),
        ),
        "cart-transport": lambda x, u: (
            0.01 * 0.05 * u[0] ** 2,
            100 * ((x[0] - 1) ** 2 + (x[1] - 0.2) ** 2) + 10 * (x[2] ** 2 + x[3] ** 2),
        ),
        "hopper-1d": lambda x, u: (
            0,
            0.8 * 0.4 - 0.8 * x[0] - 0.2 * x[1] + 10 * (0.8 * x[2] + 0.2 * x[3]) ** 2,
        ),
    }
    rng = np.random.default_rng(5)
    for name, costs in hand.items():
        problem = problems.get(name)
        x, u = rng.normal(size=problem.system.nx), rng.normal(size=problem.system.nu)
        got = problem.cost_terms(x, u, 0 * u, 0, problem.parameters.values)
        assert [float(value) for value in got] == pytest.approx(costs(x, u), rel=1e-12)


def test_the_box_slips_sticks_and_stops_by_hand() -> None:
    # The bound is 0.5 * 9.81 N: a push of 8 N from rest slips by the excess, 4 N is held.
    speed = 0.05 * (8 - 4.905)
    assert step("box-slide", [0, 0], [8])[0] == pytest.approx([0.05 * speed, speed])
    assert step("box-slide", [0, 0], [8])[1] == pytest.approx([0.05 * speed, 0], abs=1e-9)
    assert step("box-slide", [0, 0], [4])[0] == pytest.approx([0, 0], abs=1e-9)
    assert step("box-slide", [0, 0.2], [0])[0] == pytest.approx([0, 0], abs=1e-9)
    assert step("box-slide", [0, -1], [0])[0][1] == pytest.approx(-1 + 0.05 * 4.905)


@pytest.mark.parametrize("law", [Barrier(mu=1e-3), Adaptive(sigma=0.05)])
def test_pushing_left_mirrors_pushing_right(law) -> None:
    right, left = (step("box-slide", [0, s * 0.1], [s * 6.0], law) for s in (1, -1))
    assert right[0] == pytest.approx(-left[0], rel=1e-9)
    assert right[1] == pytest.approx(left[1][::-1], rel=1e-9)


def test_cart_and_box_ride_together_until_friction_gives_way() -> None:
    # Both move together up to friction g (mc + mb) = 5.886 N: 3 N give 1 m/s² to both.
    together = step("cart-transport", [0, 0, 0, 0], [3])[0]
    assert together == pytest.approx([0.05 * 0.05, 0, 0.05, 0], abs=1e-9)
    # With 12 N the box has 1.962 m/s², the cart (12 - 1.962)/2.
    box, cart = 0.05 * 1.962, 0.05 * (12 - 1.962) / 2
    apart = step("cart-transport", [0, 0, 0, 0], [12])[0]
    assert apart[2:] == pytest.approx([cart, box - cart])
    momentum = 2 * apart[2] + 1 * (apart[2] + apart[3])
    assert momentum == pytest.approx(0.05 * 12)


def test_forces_of_dry_friction_are_told_from_ways_and_motion() -> None:
    system = problems.get("box-slide").system
    sums = system.forces
    assert sums is not None
    given = [system.x, system.u, system.x_next, system.lam, system.parameters.vector]
    told = ca.Function("told", given, [sums.normal, sums.tangential, sums.slip])
    x_next, lam = step("box-slide", [0, 0.0], [8])
    normal, along, slip = told([0, 0], [8], x_next, lam, system.parameters.values)
    assert float(normal) == pytest.approx(0.05 * 9.81)
    assert float(along) == pytest.approx(-0.05 * 4.905)
    assert float(slip) == pytest.approx(x_next[1])


@pytest.mark.parametrize("height", np.linspace(0.9, 1.1, 7))
@pytest.mark.parametrize("restitution", [0.3, 0.7, 1.0])
def test_a_ball_keeps_its_share_of_the_speed_wherever_it_falls_between_nodes(height: float, restitution: float) -> None:
    """Speeds at the floor follow from the parabolas before and after; the published scheme has an error of gh.

    With restitution of the velocity alone the ratio could be anything between 0 and e.
    """
    params = ball_throw.Params(z0=height, restitution=restitution, N=40)
    path = ball_throw.roll(params, 0.0, 1.0)
    after = (path[:, 3] - 9.81 * 0.01) ** 2 + 2 * 9.81 * path[:, 1]
    fall, rise = np.sqrt(after[10]), np.sqrt(after[-1 if restitution > 0.5 else 28])
    assert fall == pytest.approx(np.sqrt(2 * 9.81 * height), rel=1e-9)
    assert rise / fall == pytest.approx(restitution, abs=0.02)


def test_a_throw_is_differentiated_as_its_closed_form() -> None:
    """The final dz/dtheta has the right sign and an error of order h, wherever the impact is between nodes."""
    g, e, d = 9.81, 0.7, 1e-6

    def height(theta: float, T: float) -> float:
        v = 3 * np.sin(theta)
        speed = np.sqrt(v**2 + 2 * g)
        rest = T - (v + speed) / g
        return e * speed * rest - g * rest**2 / 2

    worst = []
    for N in (50, 100, 200):
        params = ball_throw.Params(h=1 / N, N=N)
        T = 1 - 2 * params.h  # a bounce takes two steps
        angles = np.linspace(0, 0.5, 101)
        found = [
            ball_throw.roll(params, t + d, 3.0)[-1, 1] - ball_throw.roll(params, t - d, 3.0)[-1, 1] for t in angles
        ]
        truth = [height(t + d, T) - height(t - d, T) for t in angles]
        assert np.all(np.sign(found) == np.sign(truth))
        worst.append(np.abs(np.subtract(found, truth)).max() / (2 * d))
    assert worst[0] < 0.25
    assert worst[2] < 0.3 * worst[0]


def test_the_step_of_the_ball_is_its_simulation() -> None:
    params = ball_throw.Params()
    path, problem = ball_throw.roll(params, 0.4, 3.0), problems.get("ball-throw")
    closed = Exact().close(problem.system)
    for k in range(0, params.N):
        x_next, lam = closed.map(path[k], [0.4, 3.0], closed.p.values)
        assert np.array(x_next).ravel() == pytest.approx(path[k + 1], abs=1e-10)
        assert float(lam) >= 0


def test_the_plastic_throw_lands_on_the_floor() -> None:
    path = ball_throw.roll(ball_throw.Params(restitution=0.0), 0.0, 1.0)
    landed = int(np.argmin(path[:, 1] > 0))
    assert path[landed:, 1].max() <= 1e-12
    assert path[-1, [1, 3]] == pytest.approx([0, 0], abs=1e-12)


def test_the_hopper_stands_lifts_off_and_meets_its_stops() -> None:
    stand, lam = step("hopper-1d", [0.4, 0, 0, 0], [4 * 9.81])
    assert stand == pytest.approx([0.4, 0, 0, 0], abs=1e-6)
    assert lam[0] == pytest.approx(0.025 * 5 * 9.81, rel=1e-6)
    pulled, lam = step("hopper-1d", [0.6, 0, 3, 0], [-50])
    assert pulled[3] == pytest.approx(0.025 * (50 - 9.81), rel=1e-5)
    assert lam[0] == pytest.approx(0, abs=1e-6)
    long, lam = step("hopper-1d", [1.3, 0.31, 2, 0], [0])
    assert long[0] - long[1] == pytest.approx(1, abs=1e-6)
    assert 4 * long[2] + long[3] == pytest.approx(8 - 0.025 * 5 * 9.81, rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_drawings_are_plain_data_that_moves_with_the_state(name: str) -> None:
    spec, problem = problems.spec(name), problems.get(name)
    assert spec.draw is not None
    assert spec.frames is not None
    params, start = spec.params({}), problem.initial_states(problem.parameters.values)[0]
    here, there = spec.draw(params, start), spec.draw(params, start + 0.1)
    assert here != there
    for shape in here:
        assert all(isinstance(value, float | int | str) for value in asdict(shape).values())
    frames, sums = spec.frames(params, start), problem.system.forces
    assert len(frames) == (problem.system.nlam if sums is None else len(sums.names))
    assert np.allclose([np.hypot(frame.nx, frame.ny) for frame in frames], 1)


def test_equations_are_valid_typst() -> None:
    lines = [line for name in NAMES for line in problems.spec(name).equations]
    document = "\n\n".join(f"$ {line} $" for line in lines)
    assert typst.compile(document.encode(), format="pdf")


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("box-slide", {"friction": -0.1}, r"friction \(Coulomb's coefficient\) .* > 0, got -0.1"),
        ("box-slide", {"m": 0}, r"m \(mass of the box\) must be a number > 0 \[kg\], got 0"),
        ("ball-throw", {"z0": -0.1}, r"z0 .*above the floor.* >= 0 \[m\], got -0.1"),
        ("ball-throw", {"goal_z": -0.1}, r"goal_z .* >= 0 \[m\], got -0.1"),
        ("ball-throw", {"restitution": 1.1}, "restitution .* >= 0 and <= 1, got 1.1"),
        ("ball-throw", {"m": 0}, r"m \(mass\) must be a number > 0 \[kg\], got 0"),
        ("cart-transport", {"friction": -1}, "friction .* > 0, got -1"),
        ("cart-transport", {"mb": 0}, r"mb \(mass of the box\) .* > 0 \[kg\], got 0"),
        ("cart-transport", {"offset0": 0.6}, "the box starts off the cart: its offset is 0.6 m"),
        ("cart-transport", {"goal_offset": -0.6}, "the box shall end off the cart"),
        ("hopper-1d", {"mf": 0}, r"mf \(mass of the foot\) .* > 0 \[kg\], got 0"),
        ("hopper-1d", {"leg0": 0.1}, "leg0 = 0.1 m, which must lie between leg_min = 0.2 m"),
        ("hopper-1d", {"u_max": 30}, "the leg cannot lift the body: u_max = 30 N"),
    ],
)
def test_bad_input_gets_its_sentence(name: str, values: dict, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as raised:
        problems.get(name, **values)
    assert "\n" not in str(raised.value)


def test_pairs_without_a_normal_pair_decide_for_themselves() -> None:
    pairs = Pair("slip", 0), Pair("slip", 0), Pair("normal", 1), Pair("friction", 1)
    assert deciding_pairs(pairs) == [0, 1, 2, 2]


def test_dry_friction_says_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match=r"sliding\(q\) has shape \(1, 2\), expected \(1, 1\)"):
        time_stepping(
            "bad",
            states=signals("x [m]; v [m/s]"),
            inputs=signals("u [N]"),
            contacts=signals("floor [N s]"),
            h=0.1,
            mass=1.0,
            impulse=lambda q, v, u: u,
            sliding=lambda q: ca.SX.ones(1, 2),
            load=1.0,
            friction=0.5,
            parameters=ParameterTable(),
        )


def test_two_bodies_pressed_down_slide_as_each_would_alone() -> None:
    """One system has several loaded contacts, and a damper that acts implicitly."""

    def sliding(masses: list[float], friction: list[float], damping: float) -> np.ndarray:
        n = len(masses)
        system = time_stepping(
            "pressed",
            states=signals("; ".join([f"q{i} [m]" for i in range(n)] + [f"v{i} [m/s]" for i in range(n)])),
            inputs=signals("u [N]"),
            contacts=signals("; ".join(f"c{i} [N s]" for i in range(n))),
            h=0.1,
            mass=ca.diag(ca.SX(masses)),
            impulse=lambda q, v, u: 0.1 * u * ca.SX.ones(n),
            sliding=lambda q: ca.SX.eye(n),
            load=5.0,
            friction=ca.SX(friction),
            damping=damping * ca.SX.eye(n),
            parameters=ParameterTable(),
        )
        step = Exact().close(system)
        start = np.concatenate([np.zeros(n), np.full(n, 0.2)])
        return np.array(step.solve(start, 4.0, [])[0]).reshape(2, n)

    both = sliding([1.0, 2.0], [0.3, 0.9], 0.5)
    # (m + h d) v+ = m v + h (u - f load), or rest where friction holds.
    wanted = [(0.2 + 0.1 * (4.0 - 1.5)) / 1.05, (0.4 + 0.1 * (4.0 - 4.5)) / 2.05]
    np.testing.assert_allclose(both[1], wanted, atol=1e-12)
    np.testing.assert_allclose(both[0], 0.1 * both[1], atol=1e-12)
    for i, (m, f) in enumerate([(1.0, 0.3), (2.0, 0.9)]):
        np.testing.assert_allclose(sliding([m], [f], 0.5)[:, 0], both[:, i], atol=1e-12)
