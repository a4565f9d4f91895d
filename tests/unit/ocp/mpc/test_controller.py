"""The controller and its closed loop: independently known optimal costs, bad input, determinism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from ocp.errors import InputError
from ocp.mpc import Controller, Disturbance, simulate
from ocp.mpc.receding import Receding
from ocp.problem.problem import Constraint
from problems import get

OPTIMUM = 361.3236972
"""Optimal cost over all enumerated windows of contact, from tests/golden/test_contact_windows.py."""


@pytest.fixture(scope="module")
def walls() -> Controller:
    return Controller(get("soft-walls"))


@pytest.fixture(scope="module")
def disc() -> Controller:
    return Controller(get("push-disc"))


@pytest.mark.costly
def test_the_loop_costs_what_the_best_of_all_contact_windows_does(walls: Controller) -> None:
    """The terminal cost is the value of continuing without contact, so that the receding horizon changes nothing."""
    loop = simulate(walls, 60, certify=6)
    assert loop.costs[0] == pytest.approx(OPTIMUM, rel=1e-6)
    assert loop.survived.all()
    assert loop.certified == 1.0


@pytest.mark.costly
@pytest.mark.cheap_cases("qp")
@pytest.mark.parametrize("phase", ["qp", "policy"])
def test_other_phases_agree_where_the_plan_is_followed(phase: str) -> None:
    loop = simulate(Controller(get("soft-walls"), phase=phase), 30)
    assert loop.costs[0] == pytest.approx(OPTIMUM, rel=1e-6)


@pytest.mark.costly
def test_the_whole_route_agrees_with_one_quadratic_program(walls: Controller) -> None:
    """They agree from a disturbed start, where active sets differ from those of the first plan."""
    x0 = walls.start + np.array([0.03, 0.1, -0.2, 0.3])
    full = simulate(Controller(get("soft-walls"), phase="full"), 3, x0=x0)
    fast = simulate(walls, 3, x0=x0)
    assert fast.costs == pytest.approx(full.costs, rel=1e-6)


@pytest.mark.costly
def test_a_smoothed_plan_costs_more_on_the_exact_plant(walls: Controller) -> None:
    soft = simulate(Controller(get("soft-walls"), Barrier(mu=1e-2), "relaxed"), 40)
    assert soft.costs[0] > simulate(walls, 40).costs[0]


def test_the_same_seed_gives_the_same_bits(disc: Controller) -> None:
    given = Disturbance(noise_state=0.01, noise_input=0.01)
    first, second = (simulate(disc, 12, "exact", given, seeds=2, seed=5) for _ in range(2))
    for name in ("x", "u", "plan", "cost", "status"):
        assert np.array_equal(first.data[name], second.data[name], equal_nan=name != "status")
    one = simulate(disc, 12, "exact", given, seeds=1, seed=5)
    assert np.array_equal(one.data["x"][0], first.data["x"][0])
    assert not np.array_equal(first.data["x"][0], first.data["x"][1])


def test_noise_of_a_centimetre_does_not_stop_the_push(disc: Controller) -> None:
    loop = simulate(disc, 60, "exact", Disturbance(noise_state=0.01), seeds=3)
    goal = disc.problem.parameters
    values = dict(zip(goal.names, goal.values, strict=True))
    reached = loop.data["x"].values[:, -1, :2] - [values["goal_x"], values["goal_y"]]
    assert np.linalg.norm(reached, axis=1).max() < 0.02
    assert any("penetrates" in sentence for sentence in loop.notes)


@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        ([np.nan, 0.0, -1.0, 0.2], "not finite"),
        ([0.0, 0.0, -0.05, 0.0], "penetrates"),
        ([np.inf, np.nan, np.nan, np.nan], "not finite"),
    ],
)
def test_a_bad_measurement_is_told_and_answered(disc: Controller, state: list[float], sentence: str) -> None:
    disc.reset()
    command = disc.step(np.array(state))
    assert sentence in command.note
    assert np.isfinite(command.u).all()
    assert np.isfinite(disc.step(disc.start).u).all()


def test_a_bad_last_input_is_told_and_a_wrong_shape_refused(disc: Controller) -> None:
    disc.reset()
    command = disc.step(disc.start, u_before=np.array([np.nan, 0.0]))
    assert "the last input is not finite" in command.note
    assert np.isfinite(command.u).all()
    with pytest.raises(InputError, match="the state must have 4 numbers, got 2"):
        disc.step(np.zeros(2))
    with pytest.raises(InputError, match="the last input must have 2 numbers, got 3"):
        disc.step(disc.start, u_before=np.zeros(3))


def test_projection_is_the_smallest_motion_out(disc: Controller) -> None:
    """A pusher inside the disc is moved out: both move by the same distance along the line between them."""
    p = disc.problem.parameters.values
    x = np.array([0.0, 0.0, -0.2, 0.0])
    bounds = [np.full(4, -np.inf), np.full(4, np.inf)]
    physical = np.append(p, np.zeros(6))
    found, told = disc.measurement.project(x, x, bounds, physical[: len(p) + 6])
    phi = float(disc.problem.signed_distance(found, p)[0])
    assert phi == pytest.approx(0.0, abs=1e-9)
    assert found[[1, 3]] == pytest.approx(0.0, abs=1e-12)
    assert found[0] == pytest.approx(-(found[2] + 0.2), abs=1e-9)
    compiled = disc._phase.compiled
    assert compiled is not None
    assert disc.measurement.project(x, x, bounds, physical, compiled)[0] == pytest.approx(found, abs=1e-12)
    assert len(told) == 1


def test_references_are_parameters_over_the_horizon(disc: Controller) -> None:
    N = disc.problem.N
    disc.reset()
    still = disc.step(disc.start, parameters={"goal_x": np.full(N + 1, 1.0)})
    disc.reset()
    assert np.array_equal(disc.step(disc.start, parameters={"goal_x": 1.0}).u, still.u)
    with pytest.raises(InputError, match="needs 20 or 21 values"):
        disc.step(disc.start, parameters={"goal_x": np.ones(3)})
    with pytest.raises(InputError, match="parameter of the dynamics"):
        disc.step(disc.start, parameters={"h": np.linspace(0.1, 0.2, N)})
    with pytest.raises(InputError, match="did you mean 'goal_x'"):
        disc.step(disc.start, parameters={"goal_xx": 1.0})


def test_a_deadline_that_is_missed_sends_the_shifted_plan() -> None:
    late = Controller(get("push-disc"), deadline=1e-9)
    first = late.step(late.start)
    assert first.status != "late", "the first sample has no plan before it"
    second = late.step(first.plan.x[1])
    assert (second.status, late.misses) == ("late", 1)
    assert second.u == pytest.approx(first.plan.u[1])


@pytest.mark.costly
def test_an_observer_changes_nothing_without_noise_and_reduces_it_with(disc: Controller) -> None:
    calm = Controller(get("push-disc"), trust=0.3)
    plain, filtered = (simulate(made, 40, "exact", Disturbance(), seeds=2).costs for made in (disc, calm))
    assert filtered == pytest.approx(plain, rel=1e-6)
    noise = Disturbance(noise_state=0.01)
    plain, filtered = (simulate(made, 40, "exact", noise, seeds=16).costs for made in (disc, calm))
    # The difference of the means is over two of its standard errors; with four seeds noise hides it.
    assert filtered.mean() < plain.mean() - 5e-4
    with pytest.raises(InputError, match="trust must be a number > 0 and <= 1"):
        Controller(get("push-disc"), trust=0.0)


@pytest.mark.costly
def test_a_sample_solves_one_program_also_where_contacts_are_exchanged() -> None:
    """The exchange that a program's multipliers ask for is in the program of the next sample."""
    loop = simulate(Controller(get("spinner")), 25)
    assert set(loop.data["programs"].values[0, 1:]) == {1}
    assert loop.notes["contacts were exchanged"] > 1


def test_delay_pushes_and_mismatch_are_the_plants(disc: Controller) -> None:
    plain = simulate(disc, 4)
    delayed = simulate(disc, 4, "exact", Disturbance(delay=True))
    assert np.array_equal(delayed.data["u"][0, 0], disc._u_start)
    pushed = simulate(disc, 4, "exact", Disturbance(pushes={2: np.array([0.1, 0, 0, 0])}))
    moved = pushed.data["measured"][0, 2] - plain.data["measured"][0, 2]
    assert moved.values == pytest.approx([0.1, 0, 0, 0], abs=1e-12)
    other = simulate(disc, 4, "exact", Disturbance(mismatch={"M": 2.0}))
    assert abs(other.data["x"] - plain.data["x"]).max() > 1e-3


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"phase": "qpc"}, "unknown phase 'qpc' .did you mean 'qpcc'"),
        ({"contact": Barrier(mu=1e-2)}, "plans under the exact law, not under barrier"),
        ({"contact": Exact(), "phase": "relaxed"}, "plans under a smoothed law"),
        ({"iterations": 0}, "iterations must be a whole number >= 1 and <= 1000, got 0"),
    ],
)
def test_bad_input_gets_one_sentence(given: dict, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Controller(get("push-disc"), **given)


def test_bad_plants_get_one_sentence(disc: Controller) -> None:
    with pytest.raises(InputError, match="unknown plant 'exakt'"):
        simulate(disc, 3, "exakt")
    with pytest.raises(InputError, match="no physical parameter 'mass'"):
        simulate(disc, 3, "exact", Disturbance(mismatch={"mass": 1.0}))
    with pytest.raises(InputError, match="steps must be a whole number >= 1 and <= 1000000, got 0"):
        simulate(disc, 0)
    with pytest.raises(InputError, match="noise-state must be 0 or more"):
        simulate(disc, 3, "exact", Disturbance(noise_state=-1.0))


def test_terminal_constraints_are_softened_and_told() -> None:
    """The penalty is 100 characteristic costs times the squared violation in characteristic sizes."""
    plain = get("push-disc")
    ends = [Constraint("stop", plain.system.x[:1], 0.5, 0.5)]
    problem = replace(plain, terminal=ends)
    receding = Receding.of(problem)
    assert receding.notes == ("Terminal constraints (stop) are softened.",)
    x = np.array([0.8, 0.1, -0.5, 0.0])
    p, both = problem.parameters.values, receding.problem.parameters.values
    u, lam = np.zeros(2), np.zeros(1)
    before = float(problem.cost_terms(x, u, u, lam, p)[1])
    after = float(receding.problem.cost_terms(x, u, u, lam, both)[1])
    expected = 100 * problem.scales.cost * (0.3 / problem.natural_scales.x.max()) ** 2
    assert after - before == pytest.approx(expected)
    assert not receding.problem.terminal


def test_a_free_start_is_measured_and_told() -> None:
    [told] = [one for one in Receding.of(get("half-cheetah")).notes if "start" in one]
    assert told == "The start is measured, not chosen; periodicity is left out."


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"deadline": 0.0}, "deadline must be greater than 0"),
        ({"deadline": np.nan}, "deadline must be a finite number"),
        ({"deadline": "soon"}, "deadline must be a number, got 'soon'"),
        ({"contact": "exakt"}, "unknown contact law 'exakt' .did you mean 'exact'"),
        ({"contact": "barrier"}, "plans under the exact law, not under barrier"),
        ({"contact": 3}, "contact must be"),
        ({"policy": lambda x, k: x}, 'a policy is for the phase "policy", not for qpcc'),
        ({"policy": 3, "phase": "policy"}, "policy must be"),
        ({"parameters": {"goal_x": "far"}}, "goal_x must be numbers, got 'far'"),
        ({"parameters": {"goal_x": np.nan}}, "goal_x must be finite, got nan"),
    ],
)
def test_arguments_that_are_none_get_one_sentence(given: dict, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Controller(get("push-disc"), **given)


def test_a_law_may_be_named_as_in_solve(disc: Controller) -> None:
    named = Controller(get("push-disc"), "exact")
    assert isinstance(named.law, Exact)
    assert named.step(named.start).u.tolist() == disc_first(disc)
    assert isinstance(Controller(get("push-disc"), "barrier", "relaxed").law, Barrier)


def disc_first(disc: Controller) -> list[float]:
    disc.reset()
    return disc.step(disc.start).u.tolist()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"certify": -1}, "certify must be a whole number >= 0"),
        ({"certify": 2.5}, "certify must be a"),
        ({"seed": -1}, "seed must be a whole number >= 0"),
        ({"x0": np.zeros(3)}, "x0 must have 4 or 2 x 4 numbers, got 3"),
        ({"x0": np.zeros((3, 4))}, "x0 must have 4 or 2 x 4 numbers, got 12"),
        ({"x0": np.full(4, np.inf)}, "x0 must be finite"),
        ({"x0": "left"}, "x0 must be numbers, got 'left'"),
        ({"disturbance": Disturbance(mismatch={"M": np.nan})}, "must be a finite number"),
        ({"disturbance": Disturbance(mismatch={"M": -1.0})}, "mass matrix must be positive"),
        ({"disturbance": Disturbance(pushes={3: np.zeros(4)})}, "from 0 to 2, got 3"),
        ({"disturbance": Disturbance(pushes={-1: np.zeros(4)})}, "greater than or equal to 0"),
        ({"disturbance": Disturbance(pushes={0: np.zeros(3)})}, "must have 4 numbers, got 3"),
        ({"disturbance": replace(Disturbance(), noise_state="much")}, "noise-state must be"),
        ({"disturbance": 3}, "disturbance must be an instance of Disturbance"),
    ],
)
def test_simulations_that_cannot_be_get_one_sentence(disc: Controller, given: dict, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        simulate(disc, 3, seeds=2, **given)


def test_a_policy_of_another_size_is_refused() -> None:
    wrong = Controller(get("push-disc"), phase="policy", policy=lambda x, k: x)
    with pytest.raises(InputError, match="the policy's input must have 2 numbers, got 4"):
        wrong.step(wrong.start)
