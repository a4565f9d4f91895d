"""Remedies for plans that do not survive: closed loops recomputed by hand, verdicts, storing, exit codes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ocp
from ocp import InputError, Solution, solve
from ocp.judge.referee import COST_SHARE
from ocp.judge.route_report import StageRecord
from ocp.mpc.controller import Controller
from ocp.problem.rollout import policy_name
from ocp.solution import Interrupted
from problems import get
from tests.findings import codes, numbers

HILL = str(Path(__file__).parent / "cases" / "hill.py")
QUICK: dict[str, Any] = {"contact": "exact", "effort": "quick", "until": "survives"}


def climbed(**changes: Any) -> Solution:
    return solve(HILL, **QUICK, **changes)


@cache
def once() -> Solution:
    """The answer for the hill as it stands."""
    return climbed()


def closed_loop(answer: Solution, substeps: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, states and inputs of the hill under u = K x + k, stepped here; the wall is out of reach."""
    p = answer.values
    K, k = answer.data["K"].values[:, 0], answer.data["k"].values[:, 0]
    h, x, v = p["h"] / substeps, p["start"], 0.0
    xs, us, cost = [[x, v]], [], 0.0
    for gain, offset in zip(K, k, strict=True):
        u = float(np.clip(gain @ [x, v] + offset, -p["u_max"], p["u_max"]))
        cost += p["h"] * (x**2 + p["w_u"] * u**2)
        for _ in range(substeps):
            v += h * (p["a"] * x + u / p["m"])
            x += h * v
            assert x > -1
        xs.append([x, v])
        us.append(u)
    return cost + p["w_end"] * x**2 + p["w_rest"] * v**2, np.array(xs), np.array(us)


@pytest.mark.costly
def test_gains_survive_where_no_inputs_do_and_cost_what_their_closed_loop_costs() -> None:
    answer = once()
    ladder = answer.route.ladder
    assert ladder is not None and ladder.answer.name == "gains" and answer.referee.survives
    first, gains = ladder.rungs[0], ladder.answer
    assert first.survives is False and first.refined_cost > 10 * first.cost
    finer = [rung for rung in ladder.rungs if rung.name.startswith("steps of")]
    assert finer and not any(rung.survives for rung in finer)
    cost, x, u = closed_loop(answer, 1)
    assert gains.cost == answer.referee.cost == pytest.approx(cost, rel=1e-9)
    assert answer.data["x_referee"].values[0] == pytest.approx(x, abs=1e-9)
    assert answer.data["u_referee"].values[0, :, 0] == pytest.approx(u, abs=1e-9)
    refined_cost = closed_loop(answer, 4)[0]
    assert gains.refined_cost == pytest.approx(refined_cost, rel=1e-9)
    assert first.planned < refined_cost <= (1 + COST_SHARE) * first.planned
    finest, late = ladder.disturbed[0], ladder.disturbed[-1]
    assert finest.disturbance == "h/16" and finest.median_cost == pytest.approx(closed_loop(answer, 16)[0], rel=1e-9)
    assert late.disturbance == "inputs one step late" and (late.survived, late.draws) == (0, 1)
    share = 100 * (refined_cost / first.planned - 1)
    assert numbers(answer, "survives-by")["difference"] == f"{share:.2g} % above"
    assert "; survives with gains." in answer.headline


@pytest.mark.costly
def test_the_same_seed_gives_the_same_bits_and_the_run_is_read_back(tmp_path: Path) -> None:
    one, other = once(), climbed()
    assert repr(one.route.ladder) == repr(other.route.ladder)
    assert np.array_equal(one.data["K"], other.data["K"])
    read = ocp.load(ocp.save(one, tmp_path), source=HILL)
    assert repr(read.route.ladder) == repr(one.route.ladder)
    assert read.replay("exact").cost == pytest.approx(one.referee.cost, rel=1e-12)
    assert read.headline == one.headline


@pytest.mark.costly
def test_a_controller_is_stored_as_the_policy_that_replays_use(tmp_path: Path) -> None:
    """Gains of a plan with feedback are not replaced by others, and a controller comes next."""
    answer = climbed(policy="feedback", N=20)
    assert answer.route.ladder.answer.name == "a controller" and policy_name(answer.inputs) == "controller"
    p, controller = answer.values, Controller(answer.problem, parameters=answer.values)
    x, v, cost, states = p["start"], 0.0, 0.0, [[p["start"], 0.0]]
    for _ in range(20):
        u = float(controller.step(np.array([x, v])).u[0])
        cost += p["h"] * (x**2 + p["w_u"] * u**2)
        v += p["h"] * (p["a"] * x + u / p["m"])
        x += p["h"] * v
        states.append([x, v])
    cost += p["w_end"] * x**2 + p["w_rest"] * v**2
    read = ocp.load(ocp.save(answer, tmp_path), source=HILL)
    assert policy_name(read.inputs) == "controller" and read.headline == answer.headline
    for solution in (answer, read):
        replay = solution.replay("exact")
        assert replay.inputs == "controller" and replay.cost == pytest.approx(cost, rel=1e-9)
        for name in ("x_replay", "x_referee"):
            assert solution.data[name].values[0] == pytest.approx(np.array(states), abs=1e-9)
        assert np.abs(solution.data["x"].values[0] - states).max() > 1e-6, "the plan's states are another motion"


@pytest.mark.costly
def test_the_most_exact_contact_model_is_solved_and_stored(tmp_path: Path) -> None:
    answer = solve("planar-push", **QUICK)
    ladder = answer.route.ladder
    assert [rung.name for rung in ladder.rungs] == ["the plan", "the most exact contact model"]
    assert answer.route.most_exact and answer.success and answer.referee.survives
    assert answer.problem.system is answer.problem.system.most_exact
    assert answer.referee.cost == pytest.approx(answer.cost, rel=1e-6)
    assert ladder.rungs[0].cost > (1 + COST_SHARE) * ladder.rungs[0].planned
    assert "more expensive than the plan at its own step size" in ladder.answer.note
    read = ocp.load(ocp.save(answer, tmp_path))
    assert read.problem.system.nlam == answer.problem.system.nlam
    assert read.replay("exact").cost == pytest.approx(answer.cost, rel=1e-6)


def test_a_plan_that_survives_is_left_as_it_is() -> None:
    plain, answer = (solve("push-1d", "exact", effort="quick", until=until) for until in (None, "survives"))
    assert answer.cost == plain.cost and len(answer.route.ladder.rungs) == 1
    assert answer.headline.endswith("survives as planned.") and "survives-by" not in codes(answer)


def test_until_is_refused_where_it_means_nothing() -> None:
    with pytest.raises(InputError, match="unknown until 'tomorrow'"):
        solve("push-1d", "exact", until="tomorrow")
    with pytest.raises(InputError, match="needs a referee"):
        problem = get("push-1d")
        solve(replace(problem, system=replace(problem.system, phi=None, referee_model=None)), until="survives")


@pytest.mark.costly
def test_ctrl_c_keeps_the_best_so_far() -> None:
    seen: list[StageRecord] = []
    solve(HILL, "exact", effort="quick", N=20, progress=seen.append)

    def stop_in_the_ladder(stage: StageRecord) -> None:
        if len(seen) < len(after):
            raise KeyboardInterrupt
        after.append(stage)

    after: list[StageRecord] = []
    with pytest.raises(Interrupted) as stop:
        solve(HILL, **QUICK, N=20, progress=stop_in_the_ladder)
    kept = stop.value.solution
    assert kept.success and kept.route.ladder.answer.name == "the plan"
    assert kept.route.ladder.stopped == "Ctrl-C ended the rung finer steps"
    assert numbers(kept, "ladder-stopped")


@pytest.mark.costly
def test_a_problem_that_cannot_survive_ends_with_the_best_rung() -> None:
    """One input sequence for two starts on the hill: finer steps do not help, and gains follow one plan."""
    answer = climbed(scenarios=2)
    ladder = answer.route.ladder
    assert answer.success and not answer.referee.survives and not any(rung.survives for rung in ladder.rungs)
    tried = {rung.name: rung for rung in ladder.rungs}
    assert tried["gains"].survives is None and tried["a controller"].note == "a controller starts from one state"
    costs = [rung.most_exact_cost for rung in ladder.rungs if rung.survives is not None]
    assert ladder.answer.most_exact_cost == min(costs) and ladder.disturbed == []
    assert numbers(answer, "no-rung-survives")["cost"] == min(costs)
