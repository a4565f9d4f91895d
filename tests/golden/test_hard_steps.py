"""Steps that the path alone does not solve satisfy Coulomb's law, written here without a solver.

The states of the hopper are random, with limbs at up to 20 rad/s and motors up to their limits: at
the source's step size a limb turns so far in a step that the linearised gap is meaningless, and one
path in eleven does not converge. Velocity forces are explicit, so that motion diverges.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.contact import Barrier, ContactLaw, Exact, Step
from dynamics.contact.interior_point import repeat_until_rest
from dynamics.contact.ncp import ncp_solver
from dynamics.contact.path import MAX_ERROR
from dynamics.contact.reduced_path import path_of
from dynamics.systems import ContactSystem, Signal
from ocp.errors import NotConverged
from problems.bodies.hopper.machine import hopper
from problems.bodies.simulation import simulate, simulation
from tests.golden.coulomb_steps import ModeStepper

STATES = 300


@cache
def system() -> ContactSystem:
    return simulation("hopper", gyroscopic="explicit")[0].system


@cache
def modes() -> ModeStepper:
    machine = hopper()
    return ModeStepper(machine, machine.h, machine.friction)


@cache
def closed(law: str) -> Step:
    laws: dict[str, ContactLaw] = {"exact": Exact(), "barrier": Barrier(mu=1e-3)}
    return laws[law].close(system())


@cache
def states() -> list[tuple[np.ndarray, np.ndarray]]:
    """Draw pairs of a state (12,), its lowest sphere up to 0.2 m above the ground, and an input (3,)."""
    rng, found = np.random.default_rng(0), []
    for _ in range(STATES):
        q = np.concatenate([[0, 0], rng.uniform(-np.pi, np.pi, 1), rng.uniform(-1.5, 1.5, 3)])
        v = np.concatenate([rng.uniform(-3, 3, 2), rng.uniform(-20, 20, 4)])
        q[1] = rng.uniform(0, 0.2) - np.array(modes().contact(q)[0]).min()
        found.append((np.concatenate([q, v]), rng.uniform(-1, 1, 3)))
    return found


def by_path_alone(law: str) -> np.ndarray:
    """Return the largest violation (states,) at the end of each state's path."""
    step = closed(law)
    path, s = path_of(system(), step.exact), system()
    mu = ca.SX.sym("mu", path.n)
    inputs = [s.x, s.u, s.parameters.vector, mu]
    opening = ca.Function("opening", inputs, [path.opening_data_of(s, mu)], {"cse": True})
    ending, body = path.ending_function(), repeat_until_rest(path.iteration_function())
    errors = []
    for x, u in states():
        data = opening(x, u, s.parameters.values, 1e-3)
        errors.append(float(ca.mmax(ending(body(ca.DM.ones(path.size), data), data)[2])))
    return np.array(errors)


@dataclass(frozen=True)
class Landed:
    """Solved step: violations (20,), impulses, heights and slip (5,), and residual of the motion (6,)."""

    error: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray
    height: np.ndarray
    slip: np.ndarray
    unbalanced: np.ndarray


def landed(law: str, x: np.ndarray, u: np.ndarray) -> Landed:
    """Return the solver's step, with its terms from the equations of motion of the chain."""
    step, m = closed(law), modes()
    after, lam, _, error = (np.array(v).ravel() for v in step.solve(x, u, step.p.values))
    q, v, q_next, v_next = x[: m.nq], x[m.nq :], after[: m.nq], after[m.nq :]
    inertia, drive = (np.array(part) for part in m.motion(q, v))
    push, rub = np.array(m.contact(q)[1]), np.array(m.sliding(q))
    normal, tangential = lam[:5], lam[5:10] - lam[10:15]
    smooth = drive.ravel() + m.h * m.gears @ u
    unbalanced = inertia @ v_next - smooth - push.T @ normal - rub.T @ tangential
    assert np.allclose(q_next, q + m.h * v_next, rtol=0, atol=1e-9)
    height = np.array(m.contact(q_next)[0]).ravel()
    return Landed(error, normal, tangential, height, rub @ v_next, unbalanced)


@pytest.mark.costly
def test_one_path_in_twenty_at_least_ends_nowhere():
    """These steps, which only the search from other starts solves, are those of the tests below."""
    for law in ("exact", "barrier"):
        assert np.sum(~(by_path_alone(law) <= MAX_ERROR)) > STATES / 20


@pytest.mark.costly
def test_every_step_obeys_coulomb():
    """Steps satisfy Newton's law, no penetration, force only at contact, the cone, and maximum dissipation."""
    pressed = 0
    for x, u in states():
        end = landed("exact", x, u)
        assert np.all(end.error <= MAX_ERROR)
        assert np.abs(end.unbalanced).max() < 1e-8
        assert end.height.min() > -1e-8
        assert end.normal.min() >= 0
        assert np.abs(end.normal * end.height).max() < 1e-7
        bound = modes().friction * end.normal
        assert np.all(np.abs(end.tangential) < bound + 1e-7)
        assert np.all(end.tangential * end.slip < bound * (1e-7 - np.abs(end.slip)) + 1e-6)
        pressed += int(end.normal.max() > 0.1)
    assert pressed > STATES / 3


@pytest.mark.costly
def test_every_step_of_the_barrier_law_is_at_its_mu():
    for x, u in states():
        end = landed("barrier", x, u)
        assert np.all(end.error <= MAX_ERROR)
        assert np.abs(end.unbalanced).max() < 1e-8
        assert end.normal * end.height == pytest.approx(np.full(5, 1e-3), rel=1e-4)


@pytest.mark.costly
def test_the_search_finds_the_same_again():
    step = closed("exact")
    for k in np.flatnonzero(~(by_path_alone("exact") <= MAX_ERROR)):
        once, again = (step.solve(*states()[k], step.p.values)[1] for _ in range(2))
        assert np.array_equal(np.array(once), np.array(again))


def curved_gap(gap_of) -> ContactSystem:
    """Return a system of one contact, ``x_next = x + lam``, whose gap is a function of x_next."""
    x, x_next, lam = (ca.SX.sym(name) for name in ("x", "x_next", "lam"))
    return ContactSystem(
        name="curved",
        x=x,
        u=ca.SX.sym("u"),
        x_next=x_next,
        lam=lam,
        residual=x_next - x - lam,
        gap=gap_of(x_next),
        states=(Signal("x", "m", "position"),),
        inputs=(Signal("u", "1", "nothing"),),
        contacts=(Signal("wall", "N s", "impulse"),),
        h=0.1,
    )


@pytest.mark.parametrize("exact", [True, False])
def test_a_step_without_a_solution_is_not_solved(exact: bool):
    """``-1 - x / 10 + x² / 100`` has a root; with the other sign of x² it is negative everywhere."""
    solvable = ncp_solver(curved_gap(lambda x: -1 - x / 10 + x * x / 100), exact)
    none = ncp_solver(curved_gap(lambda x: -1 - x / 10 - x * x / 100), exact)
    _, lam, _, error = solvable(0, 0, [], 1e-8)
    assert float(error) <= MAX_ERROR
    assert float(lam) == pytest.approx(5 + np.sqrt(125), abs=1e-6)
    assert not float(none(0, 0, [], 1e-8)[3]) <= MAX_ERROR


def largest_inputs(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (30, 3))


@pytest.mark.costly
def test_a_simulation_whose_motion_overflows_says_so():
    """At the source's h the hopper's limbs turn several times in a step and thereby gain speed."""
    said = r"^hopper: step [0-9]+ has no solution: .*its motion overflows.*since step"
    with pytest.raises(NotConverged, match=said):
        simulate("hopper", 30, largest_inputs(0), seed=0, gyroscopic="explicit")


@pytest.mark.costly
def test_a_step_that_no_start_solves_is_named(monkeypatch: pytest.MonkeyPatch):
    """If no step is accepted, the message names the step and claims nothing else."""
    for module in ("ocp.problem.rollout", "problems.bodies.simulation"):
        monkeypatch.setattr(f"{module}.STEP_TOLERANCE", -1.0)
    with pytest.raises(NotConverged, match=r"at step 0 .*no other start of the search") as found:
        simulate("hopper", 30, largest_inputs(0), seed=0, gyroscopic="explicit")
    assert "no solution" not in str(found.value)


@pytest.mark.slow
def test_a_thousand_wild_simulations_stop_only_where_their_motion_overflows(
    monkeypatch: pytest.MonkeyPatch,
):
    """Each has 30 steps under the largest inputs; one step for all of them saves minutes."""
    monkeypatch.setattr("problems.bodies.simulation.get", cache(problems.get))
    finished = 0
    for seed in range(1000):
        try:
            simulate("hopper", 30, largest_inputs(seed), seed=seed, gyroscopic="explicit")
            finished += 1
        except NotConverged as stopped:
            assert "its motion overflows" in str(stopped), f"seed {seed}: {stopped}"
    assert finished > 100
