"""Effort beyond the usual route: a guess is never lost, samples only improve, and the exact replay decides."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp import solve
from ocp.errors import InputError
from ocp.judge.findings import make_finding
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import roll_out
from ocp.programs.solver import Status
from ocp.routes.homotopy import StageRecord
from ocp.search import sample_search
from ocp.search.sampling import STAGES, InputSampler
from ocp.search.search import cost_to_beat
from ocp.solution import Interrupted, Solution
from ocp.solve.starts import CERTIFIED_SHARE, SURVIVING_SHARE, best_solution
from problems import get


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(get("push-1d", N=3), contact="exact", effort="quick")


def judged(solution: Solution, planned: float, replayed: float, certified: bool = True) -> Solution:
    """Return ``solution`` with other costs, and with or without a certificate."""
    certificate = replace(solution.certificate, stationarity="B" if certified else "not")
    status = Status.SOLVED if certified else Status.NOT_OPTIMAL
    audit = replace(solution.audit, exact_cost=replayed)
    return replace(solution, cost=planned, audit=audit, certificate=certificate, status=status)


def test_a_plan_whose_replay_is_dear_loses_to_a_rollout_without_certificate(solution: Solution) -> None:
    planned_well, rolled_out = judged(solution, 0.0174, 0.88), judged(solution, 0.0273, 0.0273, certified=False)
    assert best_solution([planned_well, rolled_out]) is rolled_out
    assert best_solution([rolled_out, planned_well]) is rolled_out


def test_a_certificate_is_worth_one_percent(solution: Solution) -> None:
    changeable = 5.0 - solution.cost_share(0, 5.0)
    rough = judged(solution, 5.0, 5.0, certified=False)
    near, far = (judged(solution, cost, cost) for cost in (5.0 + 0.9 * CERTIFIED_SHARE * changeable, 5.2))
    assert best_solution([rough, near]) is near
    assert best_solution([rough, far]) is rough


def failing_finer_steps(solution: Solution) -> Solution:
    """Return ``solution`` as if its replay at h/4 failed."""
    findings = [make_finding("states-not-finite")]
    return replace(solution, referee=replace(solution.referee, refined_findings=findings))


def test_survival_at_finer_steps_decides_among_equal_costs_only(solution: Solution) -> None:
    constant = 5.0 - 1 / solution.cost_share(1.0, 5.0)
    costs = [5.0 + share * SURVIVING_SHARE * (5.0 - constant) for share in (0.0, 0.9, 1.1)]
    cheapest, near, dearer = (judged(solution, cost, cost) for cost in costs)
    failing = failing_finer_steps(cheapest)
    assert failing.referee.survives_at_h and not failing.referee.survives
    for answers in itertools.permutations([failing, near, dearer]):
        assert best_solution(answers) is near
    for answers in itertools.permutations([failing, dearer]):
        assert best_solution(answers) is failing
    for answers in itertools.permutations([cheapest, near, failing_finer_steps(near)]):
        assert best_solution(answers) is cheapest


def test_a_certificate_decides_before_survival(solution: Solution) -> None:
    rough, failing = judged(solution, 5.0, 5.0, certified=False), failing_finer_steps(judged(solution, 5.0, 5.0))
    rough_and_failing = failing_finer_steps(judged(solution, 4.9999, 4.9999, certified=False))
    for answers in itertools.permutations([rough, failing]):
        assert best_solution(answers) is failing
    for answers in itertools.permutations([rough, rough_and_failing]):
        assert best_solution(answers) is rough


@pytest.mark.costly_cases("wall-1d")
@pytest.mark.parametrize("name", ["wall-1d", "push-1d"])
def test_the_answer_is_never_worse_than_the_rollout_of_the_guess(name: str) -> None:
    problem = get(name, N=10)
    rng = np.random.default_rng(5)
    free = solve(problem, contact="exact", effort="quick")
    limits = Evaluation(problem, problem.parameters.defaults).limits
    for _ in range(3):
        noise = 0.2 * problem.scales.u * rng.standard_normal((problem.N, problem.system.nu))
        u = np.clip(free.data["u"].values[0] + noise, limits.u_lower, limits.u_upper)
        rollout = roll_out(problem, u[None], problem.parameters.defaults)
        guessed = solve(problem, contact="exact", effort="quick", guess=(rollout.x[0], u))
        assert guessed.audit.exact_cost <= rollout.cost * (1 + 1e-9)


def test_samples_are_drawn_at_normal_effort_and_not_at_quick() -> None:
    quick, normal = (solve(get("wall-1d", N=10), contact="exact", effort=effort) for effort in ("quick", "normal"))
    assert quick.route.search is None
    assert normal.route.search is not None and normal.route.search.motions > 0
    assert normal.audit.exact_cost <= quick.audit.exact_cost * (1 + 1e-7)


LIMITS = {"CATCHING_UP": (np.inf, 0.0), "UNPROMISING": (np.inf, 0.0), "SAME_COST": (0.0, np.inf)}
"""Limits of sampling beside a certified answer: values with which it never ends early, and ends after one stage."""


@pytest.mark.cheap_cases("CATCHING_UP")
@pytest.mark.parametrize("limit", ["none", *LIMITS])
def test_sampling_beside_a_certified_answer_ends_where_it_is_fruitless(limit: str, monkeypatch) -> None:
    problem = get("push-1d", N=10)
    for name, (never, at_once) in LIMITS.items():
        monkeypatch.setattr(sample_search, name, at_once if name == limit else never)
    sampled = solve(problem, contact="exact", effort=100_000)
    sampler = InputSampler(
        Evaluation(problem, problem.parameters.defaults), laws=(Exact(),), rollout_steps=100_000, adapts=False
    )
    halves = [len(sampler.runs)]
    while limit == "none" and len(halves) < STAGES:
        halves.append(-(-halves[-1] // 2))
    motions = sampler.narrowing.samples * sum(halves) * sampler.narrowing.rounds // STAGES
    assert sampled.route.search is not None
    assert motions <= sampled.route.search.motions <= motions + 4 * len(sampler.runs)
    assert sampled.certificate.certified


@pytest.mark.cheap_cases("True-0-20000")
@pytest.mark.parametrize(("idle", "restarts", "effort"), [(True, 2, "normal"), (False, 0, "normal"), (True, 0, 20_000)])
def test_sampling_begins_again_with_other_draws_while_a_plan_does_little(
    idle: bool, restarts: int, effort: float | str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The draws of each restart differ; a stated number of steps allows no restart."""
    seeds: list[Any] = []

    class Recorded(InputSampler):
        def __init__(self, evaluation: Evaluation, seed: Any, *options: Any) -> None:
            seeds.append(seed)
            super().__init__(evaluation, seed, (Exact(),), 1.0, 2000, 100, *options[-1:])

    monkeypatch.setattr(sample_search, "InputSampler", Recorded)
    monkeypatch.setattr(sample_search, "idles", lambda *_: idle)
    monkeypatch.setattr(sample_search.SampleSearch, "_is_patient", lambda *_: True)
    answer = solve(get("wall-1d", N=5), contact="exact", seed=7, effort=effort)
    assert seeds == [7, *((7, restart) for restart in range(1, restarts + 1))]
    assert answer.route.search is not None and answer.route.search.seed == 7


def test_a_seed_determines_the_answer_and_what_was_tried() -> None:
    first, again = (solve(get("wall-1d", N=10), contact="exact", seed=3) for _ in range(2))
    assert first.cost == again.cost
    assert first.route.search == again.route.search
    np.testing.assert_array_equal(first.data["u"].values, again.data["u"].values)


def test_an_unknown_effort_is_named() -> None:
    with pytest.raises(InputError, match="unknown effort 'hard'; there are quick, normal, thorough"):
        solve("wall-1d", effort="hard")


@pytest.mark.parametrize("effort", [0, -3, 1.5, np.nan, np.inf, 1e30, 1e10])
def test_an_effort_in_steps_is_a_positive_whole_number(effort: float) -> None:
    with pytest.raises(InputError, match="effort must be"):
        solve("wall-1d", effort=effort)


def test_an_effort_in_steps_is_the_number_of_steps_of_the_sampled_runs() -> None:
    at_values = Evaluation(problem := get("wall-1d"), problem.parameters.defaults)
    for budget in (10**6, 3 * 10**6):
        sampler = InputSampler(at_values, rollout_steps=budget)
        for _ in sampler.stages():
            pass
        assert 0.8 * budget < sampler.rolled_steps < 1.1 * budget


@pytest.mark.costly_cases("active set")
@pytest.mark.parametrize("stage", ["samples", "active set"])
def test_an_interrupt_of_a_search_keeps_the_best_answer(stage: str) -> None:
    problem = get("wall-1d", N=10)
    answer = solve(problem, contact="exact", effort="quick")
    seen: list[str] = []

    def stop(record: StageRecord) -> None:
        seen.append(record.label)
        if "samples" in seen and record.label == stage:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        solve(problem, contact="exact", progress=stop)
    assert stopped.value.solution.cost == pytest.approx(answer.cost, rel=1e-9)
    assert stopped.value.solution.certificate.certified


@pytest.mark.parametrize("effort", ["thorough", 10**6])
@pytest.mark.parametrize(
    "words",
    [{"contact": "barrier"}, {"contact": "exact", "method": "single-shooting"}, {"contact": "exact", "search": False}],
    ids=["another law", "shooting", "no search"],
)
def test_effort_that_would_change_nothing_is_refused(words: dict[str, Any], effort: Any) -> None:
    with pytest.raises(InputError, match=f"effort {effort} would have no effect"):
        solve("wall-1d", effort=effort, **words)


def test_samples_replace_a_certified_plan_whose_replay_failed(solution: Solution) -> None:
    lost = judged(solution, 0.01, np.nan)
    assert cost_to_beat(lost) == np.inf
    assert best_solution([lost, solution]) is solution


@pytest.mark.cheap_cases("1")
@pytest.mark.parametrize("N", [1, 2])
def test_one_step_is_sampled_too(N: int) -> None:
    quick, normal = (solve(get("wall-1d", N=N), contact="exact", effort=effort) for effort in ("quick", "normal"))
    assert not normal.route.failures
    assert normal.audit.exact_cost <= quick.audit.exact_cost * (1 + 1e-7)
