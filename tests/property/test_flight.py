"""Implicit velocity forces add no energy at any speed, and tend to the explicit ones for small h."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Link, Machine, Sphere
from dynamics.systems.parameters import ParameterTable
from dynamics.systems.planar.chain import Chain
from dynamics.systems.planar.flight import gyroscopic_impulse
from dynamics.systems.planar.machine import with_implicit_forces
from ocp.errors import InputError
from ocp.mpc.plants import Plant
from ocp.problem.rollout import roll_out
from problems import get
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper
from problems.bodies.simulation import simulate, simulation
from problems.machines.machine import PublishedMachine

CRANE = (
    Link("cart", None, 2.0, 0.1, joint="slide"),
    Link("arm", "cart", 1.0, 0.05, com=(0.2, -0.3), offset=0.4, armature=0.3),
    Link("piston", "arm", 0.5, 0.02, com=(0.05, 0.0), anchor=(0.1, -0.5), joint="slide", axis=(0.6, -0.8), offset=0.3),
    Link("hook", "piston", 0.3, 0.01, com=(0.0, -0.1), anchor=(0.0, -0.05)),
    Link("ball", None, 0.4, 0.02, com=(0.03, 0.01), joint="free"),
)
CHAINS = {
    "crane": Chain(CRANE),
    "hopper": hopper().tree(),
    "half-cheetah": half_cheetah().tree(),
}
every_chain = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
Step = Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, float]]


def free_step(chain: Chain, explicit: bool = False) -> Step:
    """Return the function from (q, v, h) to the velocity after a step without forces, and v' M(q - h v) v / 2."""
    q, v, h = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq), ca.SX.sym("h")
    forces = h * (chain.weight(q) - chain.bias(q, v)) if explicit else gyroscopic_impulse(chain, q, v, h)
    after = v + ca.solve(chain.mass(q), forces)
    found = ca.Function("step", [q, v, h], [after, chain.kinetic(q - h * v, v)])

    def step(at: np.ndarray, speed: np.ndarray, size: float) -> tuple[np.ndarray, float]:
        v_next, energy = found(at, speed, size)
        return v_next.full().ravel(), float(energy)

    return step


def energies(step: Step, q: np.ndarray, v: np.ndarray, h: float, steps: int) -> np.ndarray:
    """Return the kinetic energies along free steps, each of a velocity at the pose one step before."""
    found = []
    for _ in range(steps):
        v, energy = step(q, v, h)
        found.append(energy)
        q = q + h * v
    return np.array(found)


@every_chain
def test_free_motion_gains_no_energy_at_any_speed(chain: Chain):
    """Speeds go from 1 to 1000 rad/s, which is eight turns per step."""
    step, rng = free_step(chain), np.random.default_rng(0)
    for speed in (1.0, 10.0, 100.0, 1000.0):
        q, v = rng.normal(size=(2, chain.nq))
        found = energies(step, q, speed * v, 0.05, 50)
        assert np.all(np.diff(found) <= 1e-9 * found[0]), speed
        assert found[-1] > 0


@every_chain
def test_as_h_tends_to_zero_the_forces_are_the_explicit_ones(chain: Chain):
    """The difference ``gyroscopic_impulse / h - (weight - bias)`` is of first order in h."""
    q, v, h = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq), ca.SX.sym("h")
    off = gyroscopic_impulse(chain, q, v, h) / h - (chain.weight(q) - chain.bias(q, v))
    norm = ca.Function("off", [q, v, h], [ca.norm_2(off), ca.norm_2(chain.bias(q, v))])
    at, speed = np.random.default_rng(1).normal(size=(2, chain.nq))
    errors = [float(norm(at, speed, size)[0]) for size in (1e-3, 5e-4, 2.5e-4)]
    assert errors[0] < 0.1 * float(norm(at, speed, 0)[1])
    assert np.allclose(np.divide(errors[:-1], errors[1:]), 2, rtol=0.05)


def test_a_tumbling_hopper_keeps_its_energy():
    """It moves for two seconds without gravity, with limbs at 15 rad/s and h = 0.01."""
    q, v = np.array([0, 2, 0, 0.5, -0.5, 0.3]), np.array([1.0, 2, 5, 13, -14, 15])
    kept, gained = (energies(free_step(CHAINS["hopper"], explicit), q, v, 0.01, 200) for explicit in (False, True))
    assert 0.97 < kept[-1] / kept[0] <= 1
    assert gained[-1] / gained[0] > 1.3


def test_a_free_chain_keeps_its_momentum():
    """The momentum of all links, with the velocity at the pose one step before, is constant to rounding."""
    chain, h = CHAINS["hopper"], 0.05
    step, rng = free_step(chain), np.random.default_rng(2)
    q, v = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq)
    momentum = ca.Function("p", [q, v], [chain.momentum(q, v)])
    at, speed = rng.normal(size=(2, chain.nq)) * np.array([[1], [20]])
    first = momentum(at - h * speed, speed).full()
    for _ in range(20):
        speed = step(at, speed, h)[0]
        assert np.allclose(momentum(at, speed).full(), first, rtol=1e-9, atol=1e-9)
        at = at + h * speed


def test_a_turn_about_a_fixed_axis_in_closed_form():
    """v' = (1 - 2 a b (1 - cos(h v / 2))²) v, a and b the shares of m r² and inertia in M.

    Explicit forces are zero there and keep v; implicit ones keep all but O(h⁴) of it.
    """
    mass, inertia, r, h = 1.3, 0.1, 0.5, 0.05
    step = free_step(Chain((Link("rod", None, mass, inertia, com=(0.3, -0.4)),)))
    b = inertia / (inertia + mass * r**2)
    for v in (2.0, 10.0, 90.0):
        wanted = (1 - 2 * b * (1 - b) * (1 - np.cos(h * v / 2)) ** 2) * v
        assert step(np.array([0.4]), np.array([v]), h)[0][0] == pytest.approx(wanted, rel=1e-10)


@pytest.mark.costly_cases("half-cheetah-machine1")
@pytest.mark.parametrize(("name", "machine"), [("hopper", hopper()), ("half-cheetah", half_cheetah())])
def test_a_machine_and_its_simulation_step_alike(name: str, machine: PublishedMachine):
    s, nq = simulation(name)[0].system, len(machine.pose)
    own = machine.system("own", ParameterTable(), h=machine.h, friction=machine.friction, gyroscopic="implicit")
    rng = np.random.default_rng(4)
    x, u = rng.normal(size=2 * nq), rng.normal(size=own.nu)
    x_next, lam = rng.normal(size=2 * nq), rng.uniform(size=own.nlam)
    mine = ca.Function("r", [own.x, own.u, own.x_next, own.lam], [own.residual])
    theirs = ca.Function("r", [s.x, s.u, s.x_next, s.lam, s.parameters.vector], [s.residual])
    more = [machine.h] * (s.nx - 2 * nq)
    values = theirs([*x, *more], u, [*x_next, *more], lam, s.parameters.values).full()
    assert np.allclose(mine(x, u, x_next, lam).full(), values[: 2 * nq], rtol=1e-9, atol=1e-9)


@pytest.mark.costly_cases("hopper")
@pytest.mark.parametrize("name", ["hopper", "idto-hopper"])
def test_a_plant_steps_as_a_machine_with_implicit_forces(name: str, monkeypatch: pytest.MonkeyPatch):
    """This also holds for the most exact contact, and with a state in addition to the machine's own."""
    monkeypatch.setattr("ocp.mpc.plants.StepFunction", lambda *_, **__: None)  # it would compile
    problem = get(name)
    model = problem.system
    found = with_implicit_forces(model)
    driven = Plant(problem, "exact", {}).problem.system
    assert model.machine and driven.machine and driven.machine.gyroscopic == "implicit"
    assert ca.is_equal(driven.residual, found.residual, 100)
    chain = model.machine.machine.tree()
    q, v = model.x[: chain.nq], model.x[chain.nq : 2 * chain.nq]
    wanted = model.h * (chain.weight(q) - chain.bias(q, v)) - gyroscopic_impulse(chain, q, v, model.h)
    rng = np.random.default_rng(6)
    for old, new in ((model, found), (model.most_exact, found.most_exact)):
        symbols = [model.x, model.u, model.x_next, old.lam, model.parameters.vector]
        lam = ca.substitute(new.residual, new.lam, old.lam)
        change = ca.Function("change", symbols, [lam - old.residual, wanted])
        sizes = (model.nx, model.nu, model.nx, old.nlam)
        at = [10 * rng.normal(size=n) for n in sizes]
        got, expected = (part.full() for part in change(*at, model.parameters.values))
        assert np.allclose(got[chain.nq : 2 * chain.nq], expected, rtol=1e-9, atol=1e-9)
        assert np.abs(expected).max() > 1e-3
        assert not np.any(got[: chain.nq]) and not np.any(got[2 * chain.nq :])
    assert with_implicit_forces(found) is found


def test_the_most_exact_model_has_implicit_forces_too():
    edges = Machine(CRANE, (Sphere("hook", "hook", (0.0, 0.0), 0.1),)).system(
        "crane", ParameterTable(), h=0.05, friction=0.5, cone="edges"
    )
    found, n = with_implicit_forces(edges), edges.nx // 2
    assert edges.most_exact is not edges and found.most_exact is not found
    change = [
        ca.substitute(new.residual, new.lam, old.lam) - old.residual
        for old, new in ((edges, found), (edges.most_exact, found.most_exact))
    ]
    at = [edges.x, edges.u, edges.x_next, edges.lam, edges.most_exact.lam]
    values = [np.linspace(1, 2, part.numel()) for part in at]
    one, other = (part.full() for part in ca.Function("change", at, change)(*values))
    assert np.allclose(one, other, rtol=1e-9, atol=1e-9) and np.abs(one[n:]).max() > 1e-3


def test_a_system_without_a_planar_machine_stays_as_it_is():
    for name in ("push-disc", "reorient"):
        system = get(name).system
        assert with_implicit_forces(system) is system


def test_another_word_is_refused():
    with pytest.raises(ValueError, match="gyroscopic must be 'explicit' or 'implicit', got 'some'"):
        Machine(hopper().links, ()).system(
            "m",
            ParameterTable(),
            h=0.1,
            friction=None,
            gyroscopic="some",  # type: ignore[arg-type]
        )


def test_a_simulation_refuses_it_too():
    with pytest.raises(InputError, match="gyroscopic must be 'explicit' or 'implicit', got 'some'"):
        simulate("hopper", gyroscopic="some")  # pyright: ignore[reportArgumentType]


def fastest(seeds: int) -> float:
    """Return the largest speed [rad/s] of a limb in 30 steps from each seed's reset, with inputs up to the largest."""
    problem, _ = simulation("hopper", 30)
    starts = np.array([hopper().reset(seed) for seed in range(seeds)])
    u = np.array([np.random.default_rng(seed).uniform(-1, 1, (30, 3)) for seed in range(seeds)])
    x = roll_out(problem, u, problem.parameters.defaults, x0=starts).x
    return float(np.abs(x[:, :, 8:]).max())


def test_the_hopper_under_the_largest_inputs_overflows_no_more():
    """The explicit forces overflow with seed 0 (tests/golden/test_hard_steps.py)."""
    assert fastest(2) < 500


def test_a_simulation_has_implicit_forces_unless_told_otherwise():
    built = simulation("hopper")[0].system.machine
    told = simulation("hopper", gyroscopic="explicit")[0].system.machine
    assert built and told and (built.gyroscopic, told.gyroscopic) == ("implicit", "explicit")


@pytest.mark.costly
def test_no_seed_overflows():
    assert fastest(100) < 500
