"""The machines agree with results that do not need the path solver: enumerated modes, energy balances."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.contact import Barrier, Exact
from ocp import Direct, Solution, Status, solve
from ocp.routes import complementarity, table
from ocp.solve.judging import judge_outcome
from ocp.transcription.nlp import NLP
from problems.bodies.hopper.machine import hopper
from problems.bodies.simulation import simulate, simulation
from tests.golden.coulomb_steps import ModeStepper
from tests.golden.known import BETTER, reached, session_of


@pytest.fixture(scope="module")
def modes() -> ModeStepper:
    machine = hopper()
    return ModeStepper(machine, machine.h, machine.friction, implicit=True)


@pytest.mark.costly
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_hopper_falls_as_by_trying_all_modes_of_contact(modes: ModeStepper, seed: int):
    """Both agree over 50 steps from the source's reset, each continuing from its own states."""
    problem, x0 = simulation("hopper", seed=seed)
    rolled = simulate("hopper", law=Barrier(mu=1e-10), seed=seed)
    x, nq = x0, modes.nq
    touched = 0
    for k in range(problem.N):
        end = modes.step(x[:nq], x[nq:], np.zeros(3))
        x = np.concatenate([end.q, end.v])
        touched += int(np.any(end.normal > 1e-3))
        assert np.allclose(rolled.x[0, k + 1], x, atol=1e-6), k
    assert touched > 10


@pytest.mark.costly
def test_one_step_agrees_under_inputs(modes: ModeStepper):
    """Motors have half of their largest input, and both take every step from the same state."""
    problem, x = simulation("hopper", seed=2)
    step = Barrier(mu=1e-10).close(problem.system)
    nq, rng = modes.nq, np.random.default_rng(7)
    stuck = 0
    for _ in range(30):
        u = rng.uniform(-0.5, 0.5, 3)
        x_next = np.array(step.solve(x, u, step.p.values)[0]).ravel()
        end = modes.step(x[:nq], x[nq:], u)
        x = np.concatenate([end.q, end.v])
        assert np.allclose(x_next, x, atol=1e-6)
        edge = np.abs(end.tangential) > (1 - 1e-6) * modes.friction * end.normal
        stuck += int(np.any(~edge & (end.normal > 1e-3)))
    assert stuck > 5


def books(name: str, h: float) -> dict[str, np.ndarray]:
    """Return the energy balance [J] of every step of a fall from the reset over 1.5 s.

    ``change`` is that of energy less the dampers' work; ``contact`` the work of the impulses at the
    velocities at the end of the step; ``rubbing`` (steps, contacts) friction impulse times slip.
    """
    given: dict[str, Any] = {"h": h} if name == "hopper" else {"h_max": h, "spheres": "legs"}
    steps = round(1.5 / h)
    problem, _ = simulation(name, steps, seed=2, **given)
    rolled = simulate(name, steps, seed=2, **given)
    s = problem.system
    assert s.energy_balance is not None and s.forces is not None
    nq, n = s.nx // 2, problem.system.nlam
    push = ca.jacobian(s.residual[nq : 2 * nq], s.lam)
    contact = -ca.dot(s.x_next[nq : 2 * nq], push @ s.lam)
    book = ca.Function(
        "book",
        [s.x, s.u, s.x_next, s.lam, s.parameters.vector],
        [s.energy_balance.energy, s.energy_balance.work, contact, s.forces.tangential * s.forces.slip],
    ).map(steps)
    x = rolled.x[0]
    found = book(x[:-1].T, rolled.u[0].T, x[1:].T, rolled.lam[0].T, s.parameters.values)
    energy, work, done, rubbing = (np.array(v) for v in found)
    assert rubbing.shape[1] == steps and rolled.lam.shape[2] == n
    return {
        "change": np.diff(energy[0]) - work[0, :-1],
        "contact": done[0, :-1],
        "rubbing": rubbing.T,
    }


@pytest.mark.costly
@pytest.mark.parametrize("name", ["hopper", "half-cheetah"])
def test_contact_takes_energy_and_gives_none(name: str):
    """Impact and friction do no positive work at the velocities after the step."""
    found = books(name, 0.05)
    assert found["contact"].min() < -5
    assert found["contact"].max() <= 1e-8
    assert found["rubbing"].min() < -1e-5
    assert found["rubbing"].max() <= 1e-10
    assert found["change"].max() <= 1e-6


@pytest.mark.costly
def test_what_the_energy_book_lacks_falls_with_the_square_of_the_step():
    """No step adds more energy to the hopper than the integrator's error."""
    gained = [np.max(f["change"] - f["contact"]) for f in (books("hopper", h) for h in (0.05, 0.0125))]
    assert 0 < gained[1] < gained[0] / 8 < 1e-4


@pytest.mark.slow
def test_the_hopper_hops_a_metre_and_lands_at_rest():
    found = reached("hopper", "exact")
    assert found.success
    x, nq = found.data["x"].values[0], 6
    assert np.abs(x[-1, :nq] - [1, 1.21, 0, 0, 0, 0]).max() < 0.02
    assert np.abs(x[-1, nq:]).max() < 0.1
    in_the_air = found.data["phi"].values[0].min(axis=1) > 0.02
    assert in_the_air.sum() >= 5
    assert found.audit.state_gap < 1e-2


def check_gait(found: Solution, speed: float):
    """Check that a stride is periodic, has the given speed, keeps the motors' bounds, and replays the same."""
    x, u = found.data["x"].values[0], found.data["u"].values[0]
    stride = len(u) * x[0, -1]
    assert (x[-1, 0] - x[0, 0]) / stride == pytest.approx(speed, abs=1e-6)
    assert np.allclose(x[-1, 1:], x[0, 1:], atol=1e-6)
    assert np.abs(u).max() <= 1 + 1e-8
    assert found.audit.penetration < 1e-8
    assert found.audit.state_gap < 1e-2
    assert found.audit.exact_cost == pytest.approx(found.cost, rel=1e-3)


@pytest.mark.costly
def test_the_half_cheetahs_best_gait_is_a_gait():
    check_gait(reached("half-cheetah", "exact"), 1.0)


@pytest.mark.costly
def test_a_gait_settled_on_its_first_branch_is_not_optimal(monkeypatch: pytest.MonkeyPatch):
    """Seven pairs are biactive, and the certificate names those whose change lowers the cost."""
    guesses = NLP.active_sets
    monkeypatch.setattr(NLP, "active_sets", lambda nlp, x: guesses(nlp, x)[:1])
    monkeypatch.setattr(complementarity, "improve", lambda _, found, *limits: found)
    monkeypatch.setattr(table, "FURTHER_PATHS", ())
    session = session_of("half-cheetah")
    found = judge_outcome(session, session.solve(), 0)
    check_gait(found, 1.0)
    assert found.status is Status.NOT_OPTIMAL
    assert found.cost == pytest.approx(0.0517645, rel=1e-5)
    assert found.certificate.biactive == 7
    assert found.certificate.lpec_decrease > 1e-4
    named = {move.contact for move in found.certificate.moves}
    assert named <= {signal.name for signal in found.problem.system.contacts}
    assert "foot" in str(found.certificate.moves[0])
    assert found.referee.survives_at_h and found.grade == "failed"


@pytest.mark.costly
def test_the_default_route_goes_where_the_certificate_points():
    found = solve(problems.get("half-cheetah"), Exact(), Direct())
    check_gait(found, 1.0)
    assert found.success and found.certificate.stationarity == "B"
    assert found.cost < 0.05144
    assert found.cost >= problems.spec("half-cheetah").golden["exact"].cost * (1 - BETTER)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.5, 1.5, 2.0])
def test_the_half_cheetah_has_a_gait_at_other_speeds(speed: float):
    check_gait(solve(problems.get("half-cheetah", speed=speed), Exact(), Direct()), speed)
