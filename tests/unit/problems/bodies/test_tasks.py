"""The named tasks: physics of the problems, rewards, resets and ends of the sources, unknown masses."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.contact import Exact
from dynamics.systems import ContactSystem
from ocp.errors import InputError
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper
from problems.library import ball_throw
from problems.tasks import registry

MACHINES = {"hopper": hopper(), "half-cheetah": half_cheetah()}
RNG = np.random.default_rng(3)


def stepped(system: ContactSystem, x: np.ndarray, u: np.ndarray, **values: float) -> np.ndarray:
    """Return x_next (nx,) under the exact law, from the step's solver."""
    step = Exact().close(system)
    x_next, _, _, error = step.solve(x, u, step.p.pack(values))
    assert np.all(np.array(error) < 1e-8)
    return np.array(x_next).ravel()


@pytest.mark.costly
@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("spheres", ["all", "default"])
def test_a_machine_steps_as_its_problem(name: str, spheres: str):
    wanted = {"hopper": "outer", "half-cheetah": "legs"}[name] if spheres == "default" else spheres
    task = registry.get(name, spheres=wanted)
    system = problems.get(name, spheres=wanted).system
    own = (0.05,) if name == "half-cheetah" else ()
    for x in _on_the_ground(name):
        u = RNG.uniform(-1, 1, system.nu)
        ours = stepped(task.system, x, u)
        theirs = stepped(system, np.append(x, own), u, h=0.05)
        np.testing.assert_allclose(ours, theirs[: len(ours)], rtol=1e-9, atol=1e-9)
    assert [c.name for c in task.system.contacts] == [c.name for c in system.contacts]


def _on_the_ground(name: str) -> list[np.ndarray]:
    """Return two states (q, v), one with feet on the ground and one in the air."""
    machine = MACHINES[name]
    poses = []
    for lift in (-0.04 if name == "hopper" else 0.0, 0.3):
        q = np.array(machine.pose)
        q[1] += lift
        poses.append(np.concatenate([q, RNG.uniform(-0.5, 0.5, len(q))]))
    return poses


@pytest.mark.costly
@pytest.mark.parametrize("name", MACHINES)
def test_weights_are_parameters_and_those_of_the_table(name: str):
    task = registry.get(name)
    defaults = task.parameters.defaults
    for link in MACHINES[name].links:
        assert defaults[f"mass_{link.name}"] == link.mass
        assert defaults[f"inertia_{link.name}"] == link.inertia
    heavier = registry.get(name, mass_torso=20.0)
    x, u = _on_the_ground(name)[1], np.full(task.system.nu, 0.5)
    turned = stepped(task.system, x, u, mass_torso=20.0)
    np.testing.assert_allclose(stepped(heavier.system, x, u), turned, rtol=1e-12)
    assert np.abs(turned - stepped(task.system, x, u)).max() > 1e-3


@pytest.mark.parametrize(("name", "height", "noise"), [("hopper", 1.5, 0.005), ("half-cheetah", 0.826509, 0.1)])
def test_starts_are_those_of_the_source(name: str, height: float, noise: float):
    task = registry.get(name)
    starts = task.reset(500, np.random.default_rng(1))
    middle = np.concatenate([MACHINES[name].pose, np.zeros(task.system.nx // 2)])
    middle[1] = height
    assert np.all(np.abs(starts - middle) <= noise)
    # Uniform noise spreads every component up to its bound, with the deviation noise / sqrt(3).
    np.testing.assert_allclose(starts.std(axis=0), noise / np.sqrt(3), rtol=0.1)
    np.testing.assert_array_equal(starts, task.reset(500, np.random.default_rng(1)))


def test_rewards_are_those_of_the_source():
    for name, of_input, alive in (("hopper", 1e-4, 0.1), ("half-cheetah", 0.1, 0.0)):
        task = registry.get(name)
        nx, nu, p = task.system.nx, task.system.nu, task.parameters.values
        x, u, x_next = (RNG.normal(size=n) for n in (nx, nu, nx))
        expected = x_next[nx // 2] + alive - of_input * u @ u
        assert float(task.rewards(x, u, x_next, p)) == pytest.approx(expected, abs=1e-12)
        speed, height = np.array(task.measure(x, u, x_next, p)).ravel()
        assert speed == pytest.approx((x_next[0] - x[0]) / 0.05)
        assert height == x_next[1]


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize(
    ("index", "value", "over"),
    [
        (1, 0.7, True),
        (1, 0.701, False),
        (2, 0.2, True),
        (2, -0.2, True),
        (2, 0.199, False),
        (8, -100.0, True),
        (8, 99.9, False),
        (4, np.nan, True),
        (0, -np.inf, True),
    ],
)
def test_a_hopper_is_done_where_the_source_says(index: int, value: float, over: bool):
    task = registry.get("hopper")
    x = np.concatenate([MACHINES["hopper"].pose, np.zeros(6)])
    x[index] = value
    assert bool(task.ends(x, task.parameters.values)) == over


def test_a_hopper_lasts_until_it_is_done():
    task = registry.get("hopper")
    system, p = task.system, task.parameters.values
    lasts = ca.Function("lasts", [system.x, task.parameters.vector], [task.lasts])
    states = RNG.normal(size=(400, 12)) * np.array([1, 0.4, 0.15, *[1.0] * 3, *[45.0] * 6])
    states[:, 1] += 1.0
    lasting = (np.array(lasts.map(400)(states.T, ca.repmat(p, 1, 400))) > 0).all(axis=0)
    over = np.array([bool(task.ends(x, p)) for x in states])
    np.testing.assert_array_equal(lasting, ~over)
    assert 50 < over.sum() < 350


def test_a_half_cheetah_is_done_only_where_it_is_no_number():
    task = registry.get("half-cheetah")
    for value, over in ((1e9, False), (-0.7, False), (np.nan, True), (np.inf, True)):
        x = np.zeros(18)
        x[1] = value
        assert bool(task.ends(x, task.parameters.values)) == over


def test_observations_leave_the_place_out_and_the_hopper_clips():
    x = np.arange(12.0) * np.where(np.arange(12) % 2, 3.0, -3.0)
    hops = registry.get("hopper")
    seen = np.array(hops.observe(x, hops.parameters.values)).ravel()
    np.testing.assert_array_equal(seen, np.append(x[1:6], np.clip(x[6:], -10, 10)))
    runs, x = registry.get("half-cheetah"), RNG.normal(0, 30, 18)
    seen = np.array(runs.observe(x, runs.parameters.values)).ravel()
    np.testing.assert_array_equal(seen, x[1:])


@pytest.mark.parametrize("given", [{}, {"fixed_speed": 1, "speed": 3.0}])
def test_the_throw_that_the_goal_is_made_of_loses_nothing(given: dict[str, float]):
    task = registry.get("ball-throw", **given)
    step = Exact().close(task.system)
    p, x = step.p.values, task.reset(1, np.random.default_rng(0))[0]
    assert task.lower.tolist() == ([-1.5] if given else [-1.5, 0.0])
    for k in range(task.horizon):
        u = np.array([0.6, 3.0])[: task.system.nu] if k == 0 else task.upper / 2
        x = np.array(step.solve(x, u, p)[0]).ravel()
        assert float(task.rewards(x, u, x, p)) == 0
    assert float(task.finals(x, p)) == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(x, ball_throw.roll(ball_throw.Params(), 0.6, 3.0)[-1], atol=1e-9)


def test_a_missed_goal_costs_its_distance_and_the_velocitys_error():
    task = registry.get("ball-throw", goal_x=1.0, goal_z=2.0, goal_vx=3.0, goal_vz=4.0, w_v=0.1)
    x = np.array([1.5, 1.0, 1.0, 1.0, 0.0, 0.0])
    expected = -(0.5**2 + 1.0**2) - 0.1 * (2.0**2 + 3.0**2)
    assert float(task.finals(x, task.parameters.values)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "given"),
    [*((name, {}) for name in registry.names()), ("ball-throw", {"fixed_speed": 1})],
)
def test_every_parameter_has_an_effect_and_its_default(name: str, given: dict[str, int]):
    task = registry.get(name, **given)
    system = task.system
    parts = [system.residual, system.gap, task.start, task.reward, task.final, task.done]
    measured = [each.expression for each in task.measures]
    used = {str(symbol) for symbol in ca.symvar(ca.vertcat(*map(ca.SX, parts), *measured))}
    assert set(task.parameters.names) <= used
    defaults = registry.spec(name).params(given).model_dump()
    assert task.parameters.defaults == {key: defaults[key] for key in task.parameters.names}


def test_names_and_what_is_refused():
    assert registry.names() == ["ball-throw", "hopper", "half-cheetah"]
    for name in registry.names():
        spec = registry.spec(name)
        task = spec.task()
        assert spec.name == task.name == name
        assert spec.equations
        start = task.reset(1, np.random.default_rng(0))[0]
        assert spec.draw(spec.params({}), start)
        normal = [pair for pair in task.system.pairs if pair.kind == "normal"]
        assert len(spec.frames(spec.params({}), start)) == max(len(normal), 1)
    with pytest.raises(InputError, match=r"unknown task 'hoper' .did you mean 'hopper'"):
        registry.get("hoper")
    with pytest.raises(InputError, match=r"mass_torso .* must be a number > 0 .kg., got -1"):
        registry.get("hopper", mass_torso=-1.0)
    with pytest.raises(InputError, match="horizon"):
        registry.get("half-cheetah", horizon=0)
