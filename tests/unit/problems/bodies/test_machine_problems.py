"""Hopper and half-cheetah as problems: their switches, starts, drawings, and rejected values."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import typst

import problems
from dynamics.contact import Exact
from ocp import Direct, solve
from ocp.errors import InputError
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper
from problems.bodies.simulation import simulate, simulation
from problems.drawing import Circle, Shape, Stadium, Wall

MACHINES = {"hopper": hopper, "half-cheetah": half_cheetah}


def normals(name: str, **params) -> list[str]:
    """Return the names of a problem's normal contacts."""
    system = problems.get(name, **params).system
    return [contact.name for contact, pair in zip(system.contacts, system.pairs, strict=True) if pair.kind == "normal"]


@pytest.mark.costly
@pytest.mark.parametrize(("name", "few", "some", "every"), [("hopper", 2, 4, 5), ("half-cheetah", 2, 4, 9)])
def test_spheres_choose_which_parts_touch(name: str, few: int, some: int, every: int):
    foot = "foot" if name == "hopper" else "feet"
    assert len(normals(name, spheres=foot)) == few
    assert len(normals(name)) == some
    assert normals(name, spheres="all") == [s.name for s in MACHINES[name]().spheres]
    assert len(normals(name, spheres="all")) == every
    for spheres in (foot, "all"):
        spec, problem = problems.spec(name), problems.get(name, spheres=spheres)
        assert spec.frames is not None
        params = spec.params({"spheres": spheres})
        start = problem.initial_states(problem.parameters.values)[0]
        assert len(spec.frames(params, start)) == len(normals(name, spheres=spheres))


def test_half_cheetah_in_full_has_48_pairs_and_hopper_20():
    assert simulation("half-cheetah")[0].system.nlam == 48
    assert simulation("hopper")[0].system.nlam == 20
    assert simulation("hopper", limits=1)[0].system.nlam == 26


@pytest.mark.parametrize("name", MACHINES)
def test_smooth_ground_has_normal_pairs_and_limits_only(name: str):
    smooth = problems.get(name, friction=0)
    assert {pair.kind for pair in smooth.system.pairs} <= {"normal", "limit"}
    assert "friction" not in smooth.parameters.names
    assert "friction" in problems.get(name).parameters.names


@pytest.mark.costly
def test_base_damping_drags_the_torso():
    slow, fast = (simulate("hopper", 3, seed=2, base_damping=d).x[0, -1, 7] for d in (50.0, 0.0))
    # In the air v+ = v - h (g + d v+/m), which is slower by about d h t v/m with 50 N s/m on 15.3 kg.
    assert fast == pytest.approx(-9.81 * 0.15, abs=0.05)
    assert fast + 0.2 < slow < 0


@pytest.mark.parametrize(("name", "height", "noise"), [("hopper", 1.5, 0.005), ("half-cheetah", 0.826509, 0.1)])
def test_resets_are_those_of_the_source(name: str, height: float, noise: float):
    machine = MACHINES[name]()
    starts = np.array([machine.reset(seed) for seed in range(200)])
    lifted = np.concatenate([machine.pose, np.zeros(len(machine.pose))])
    lifted[1] = height
    off = starts - lifted
    assert np.all(np.abs(off) <= noise)
    assert np.all(off.max(axis=0) > 0.9 * noise)
    assert np.all(off.min(axis=0) < -0.9 * noise)
    problem, x0 = simulation(name, seed=3)
    assert np.array_equal(x0[: starts.shape[1]], starts[3])
    step = ca.Function("h", [problem.system.x, problem.parameters.vector], [problem.system.h])
    assert float(step(x0, problem.parameters.values)) == machine.h == 0.05


@pytest.mark.costly
def test_motors_of_a_simulation_are_not_clipped():
    wide, tight = (simulate("hopper", 2, np.full((2, 3), 0.1), u_max=u) for u in (1.0, 0.01))
    assert np.all(tight.u == 0.1)
    assert np.array_equal(wide.x, tight.x)
    assert np.abs(tight.x - simulate("hopper", 2).x).max() > 0.1


def test_a_start_pose_reaches_the_start_and_the_guess():
    problem = problems.get("hopper", z0=1.6, pitch0=0.1, thigh0=0.2, leg0=0.3, foot0=-0.4)
    p = problem.parameters.values
    start = problem.initial_states(p)[0]
    assert np.array_equal(start, [0, 1.6, 0.1, 0.2, 0.3, -0.4, 0, 0, 0, 0, 0, 0])
    X, _ = problem.initial_guess(p)
    assert np.allclose(X[0, 1:6], start[1:6])
    assert np.allclose(X[-1, :6], [1, 1.21, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("hopper", {"friction": -1}, "friction .* must be a number >= 0, got -1"),
        ("hopper", {"z0": 1.0}, "toe starts 0.21 m inside the ground; .* a height of 1.21 m"),
        ("hopper", {"foot0": 0.5}, "the toe starts .* inside the ground"),
        ("hopper", {"pitch0": 3.14159, "z0": 0.2}, "the torso starts 0.05 m inside the ground"),
        ("hopper", {"limits": 1, "thigh0": -0.2, "z0": 2}, "joint thigh starts at -0.2 rad, past"),
        ("hopper", {"limits": 1, "foot0": 1, "z0": 2}, "joint foot starts at 1 rad, past"),
        ("hopper", {"spheres": "none"}, "'outer' or 'all' or 'foot', got 'none'"),
        ("half-cheetah", {"friction": -0.1}, "friction .* must be a number >= 0"),
        ("half-cheetah", {"h_min": 0.1}, "h_min = 0.1 s, is above the largest"),
        ("half-cheetah", {"u_max": 0}, "u_max .* must be a number > 0"),
    ],
)
def test_bad_input_gets_its_sentence(name: str, values: dict, sentence: str):
    with pytest.raises(InputError, match=sentence) as raised:
        problems.get(name, **values)
    assert "\n" not in str(raised.value)


def test_simulations_refuse_what_does_not_fit():
    with pytest.raises(InputError, match="not a machine that can be simulated; available: hopper, half-cheetah"):
        simulate("push-disc")
    with pytest.raises(InputError, match=r"shape \(50, 2\), expected \(50, 3\)"):
        simulate("hopper", inputs=np.zeros((50, 2)))


def distance(disc: Circle, bar: Stadium) -> float:
    """Return the distance from a disc's middle to a bar's axis."""
    a, b = np.array([bar.x1, bar.y1]), np.array([bar.x2, bar.y2])
    p = np.array([disc.x, disc.y])
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return float(np.linalg.norm(a + t * (b - a) - p))


def parts(name: str, state: np.ndarray) -> tuple[list[Stadium], list[Circle], list[Shape]]:
    spec = problems.spec(name)
    assert spec.draw is not None
    shapes = spec.draw(spec.params({}), state)
    bars = [shape for shape in shapes if isinstance(shape, Stadium)]
    return bars, [shape for shape in shapes if isinstance(shape, Circle)], shapes


@pytest.mark.parametrize("name", MACHINES)
def test_the_drawing_is_one_body_with_every_sphere_on_it(name: str):
    machine = MACHINES[name]()
    state = np.append(machine.reset(1), 0.02)
    state[3:9] += 0.3
    bars, discs, shapes = parts(name, state)
    assert Wall(0, 0, 0, 1) in shapes
    chain = machine.tree()
    q = ca.SX(state[: chain.nq])
    centres = [np.array(ca.DM(chain.position(q, s.link, s.centre))).ravel() for s in machine.spheres]
    assert np.allclose([[disc.x, disc.y] for disc in discs], centres)
    assert all(min(distance(disc, bar) for bar in bars) < 1e-12 for disc in discs)
    joined, left = [bars[0]], bars[1:]
    while left:
        touching = [bar for bar in left if any(meet(bar, other) for other in joined)]
        assert touching, "a limb hangs loose"
        joined += touching
        left = [bar for bar in left if bar not in touching]


def meet(one: Stadium, other: Stadium) -> bool:
    """Return whether an end of one bar lies on the other's axis."""
    ends = [(one.x1, one.y1), (one.x2, one.y2)]
    ends_other = [(other.x1, other.y1), (other.x2, other.y2)]
    return any(distance(Circle(*end, 0.1), other) < 1e-9 for end in ends) or any(
        distance(Circle(*end, 0.1), one) < 1e-9 for end in ends_other
    )


@pytest.mark.parametrize("name", MACHINES)
def test_forces_are_drawn_where_spheres_touch_the_ground(name: str):
    spec, machine = problems.spec(name), MACHINES[name]()
    assert spec.frames is not None
    state = np.concatenate([machine.pose, np.zeros(len(machine.pose) + 1)])
    names = normals(name)
    frames = dict(zip(names, spec.frames(spec.params({}), state), strict=True))
    assert all((frame.nx, frame.ny) == (0, 1) for frame in frames.values())
    lowest = {"hopper": "toe", "half-cheetah": "ffoot"}[name]
    height = {"hopper": 0.04, "half-cheetah": 0.0}[name]
    assert frames[lowest].y == pytest.approx(height, abs=1e-5)


@pytest.mark.parametrize("name", MACHINES)
def test_show_has_equations_that_typeset_and_a_citation_that_exists(name: str):
    spec = problems.spec(name)
    document = "\n\n".join(f"$ {line} $" for line in spec.equations)
    assert typst.compile(document.encode(), format="pdf")
    assert len(spec.equations) >= 4
    for row in problems.describe(spec):
        assert row["description"] and row["unit"], row


OWN = """
import casadi as ca
from dynamics.systems import Link, Machine, Sphere
from ocp.problem.problem import Problem
from problems import Parameters, table

name, title = "own", "A machine of one's own"


class Params(Parameters):
    pass


def build(params):
    p = table(params)
    links = (Link("body", PARENT, MASS, 0.1), Link("leg", "body", 1.0, 0.1))
    machine = Machine(links, (Sphere("tip", "leg", (0, -0.5), 0.1),))
    system = machine.system(name, p, h=0.1, friction=0.5)
    return Problem(
        name=name, system=system, N=2, stage_cost=ca.sumsqr(system.x), terminal_cost=ca.SX(0),
        x0=ca.SX.zeros(4), parameters=p,
    )
"""


@pytest.mark.parametrize(
    ("parent", "mass", "sentence"),
    [
        ("None", "0.0", "link 'body': mass must be positive, got 0"),
        ('"leg"', "1.0", "the links form a cycle, .*; a tree needs a link without parent"),
    ],
)
def test_a_users_machine_that_cannot_be_gets_its_sentence(tmp_path, parent, mass, sentence):
    path = tmp_path / "own.py"
    path.write_text(OWN.replace("PARENT", "None").replace("MASS", "1.0"))
    assert problems.load(path).name == "own"
    path.write_text(OWN.replace("PARENT", parent).replace("MASS", mass))
    with pytest.raises(InputError, match=sentence) as raised:
        problems.get(str(path))
    assert "\n" not in str(raised.value)


@pytest.mark.costly
def test_a_gait_over_the_second_order_cone():
    problem = problems.get("half-cheetah", cone="second-order")
    assert problem.system.nlam == 4 + 12 + 2 * 4
    solution = solve(problem, contact=Exact(), method=Direct())
    assert solution.success
    way = solution.data["x"].sel(state="torso_x").values[0, -1]
    duration = solution.data["time"].values[-1]
    np.testing.assert_allclose(way / duration, 1.0, rtol=1e-6)
    assert solution.audit.cone_violation < 1e-8
    assert solution.audit.dissipation_residual < 1e-8
