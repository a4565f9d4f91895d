"""Homotopies over NLPs: warm starts, stepping back, the table of stages, and changes of the formulation."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from ocp import Direct, OpenLoop, solve
from ocp.programs.solver import Point, Solver
from ocp.routes.homotopy import Homotopy, HomotopyPath, HomotopyStage, StageRecord, geometric, translate
from ocp.routes.relaxations import STRATEGIES
from ocp.routes.session import Session
from problems import get

VALUES = [0.05, 0.02, 0.01, 0.005]


@functools.cache
def session() -> Session:
    return Session(get("push-1d", N=6), Barrier(mu=0.05), Direct(), OpenLoop())


def follow(plan, values=VALUES, strict: bool = True, complete=None, progress=None):
    """Follow a path of mu; return the follower, and the result, its NLP and whether the path was finished."""
    found = session()
    follower = Homotopy(found.nlp_of, Solver(), found.values, progress)
    start = found.first_point(found.nlp_of("product"))
    end = follower.follow(HomotopyPath(values, plan, strict, complete), start)
    return follower, (end.result, end.nlp, end.finished)


def at_mu(mu: float, **options) -> HomotopyStage:
    return HomotopyStage("mu", mu, parameters={"contact.mu": mu}, options=options)


def failing(where: float, times: int):
    """Return a function that builds stages, of which those at ``where`` fail for the first ``times`` calls."""
    left = [times]

    def stage(mu: float) -> HomotopyStage:
        if mu == where and left[0] > 0:
            left[0] -= 1
            return at_mu(mu, max_iter=0)
        return at_mu(mu)

    return stage


def told(follower: Homotopy) -> list[tuple[float, bool]]:
    return [(line.value, line.accepted) for line in follower.trace.records]


def test_a_path_is_followed_to_its_end_with_falling_complementarity() -> None:
    follower, (result, nlp, finished) = follow(at_mu)
    assert finished
    assert told(follower) == [(mu, True) for mu in VALUES]
    for line in follower.trace.records:
        assert line.complementarity == pytest.approx(line.value, rel=1e-5)
        assert line.residual < 1e-8
    lam, gap = result.point.x[nlp.pairs]
    np.testing.assert_allclose(lam * gap, VALUES[-1], rtol=1e-5)
    assert follower.trace.iterations == sum(line.iterations for line in follower.trace.records)


def test_a_stage_that_fails_once_is_stepped_back_from() -> None:
    """If the middle value fails, the geometric mean is tried, then the value again, then the last one."""
    follower, (_, _, finished) = follow(failing(0.01, 1))
    assert finished
    between = math.sqrt(0.02 * 0.01)
    expected = [(0.05, True), (0.02, True), (0.01, False), (between, True), (0.01, True), (0.005, True)]
    assert [ok for _, ok in told(follower)] == [ok for _, ok in expected]
    np.testing.assert_allclose([v for v, _ in told(follower)], [v for v, _ in expected])


def test_the_point_before_a_failure_is_what_the_step_back_starts_from() -> None:
    _, (result, _, _) = follow(at_mu)
    _, (stepped, _, _) = follow(failing(0.01, 1))
    assert stepped.f == pytest.approx(result.f, rel=1e-8)


def test_a_value_that_always_fails_ends_the_path_unfinished() -> None:
    follower, (result, _, finished) = follow(failing(0.01, 10**6))
    assert not finished
    assert not result.ok
    values = [value for value, _ in told(follower)]
    assert 0.005 not in values, "nothing beyond the failure is claimed"
    assert values.count(0.01) >= 2
    assert len(values) < 20, "stepping back ends"
    kept = [value for value, ok in told(follower) if ok]
    assert all(value > 0.01 for value in kept)
    assert len(follower.trace.points) == len(kept)


def test_a_first_stage_that_fails_has_nothing_to_step_back_to() -> None:
    follower, (result, _, finished) = follow(failing(0.05, 1))
    assert not finished
    assert not result.ok
    assert told(follower) == [(0.05, False)]


def test_a_preparing_path_keeps_its_last_good_point() -> None:
    _, (result, _, finished) = follow(failing(0.01, 10**6), strict=False)
    assert finished
    assert result.ok


def test_a_path_may_be_complete_early() -> None:
    follower, (_, _, finished) = follow(at_mu, complete=lambda nlp, result: True)
    assert finished
    assert len(told(follower)) == 1


def test_warm_stages_cost_less_than_cold_ones() -> None:
    values = [0.05, 0.045, 0.04]
    follower, _ = follow(at_mu, values)
    first, *rest = (line.iterations for line in follower.trace.records)
    assert max(rest) < first


def test_progress_hears_every_line() -> None:
    heard: list[StageRecord] = []
    follower, _ = follow(at_mu, progress=heard.append)
    assert heard == follower.trace.records


@pytest.mark.parametrize(
    ("start", "end", "factor", "count"),
    [(1.0, 1e-3, 0.1, 4), (1.0, 1e-3, 0.2, 6), (0.5, 0.5, 0.1, 1), (1e-4, 1e-2, 0.1, 1)],
)
def test_geometric_values(start: float, end: float, factor: float, count: int) -> None:
    values = geometric(start, end, factor)
    assert len(values) == count
    assert values[-1] == end
    if count > 1:
        assert values[0] == start
        ratios = np.divide(values[1:], values[:-1])
        np.testing.assert_allclose(ratios, ratios[0])
        assert factor - 1e-12 <= ratios[0] < 1, "never a longer step than asked"


def test_translation_keeps_what_both_forms_have() -> None:
    exact = Session(get("push-1d", N=3), Exact(), Direct(), OpenLoop())
    source, target = exact.nlp_of("product"), exact.nlp_of("none")
    noise = np.random.default_rng(0)
    point = Point(*(noise.standard_normal(size) for size in (source.n, source.n, source.m)))
    moved = translate(point, source, target)
    assert moved.lam_g is not None and moved.lam_g.size == target.m < source.m
    np.testing.assert_array_equal(moved.x, point.x)
    before, after = source.constraints.unpack(point.lam_g), target.constraints.unpack(moved.lam_g)
    assert set(after) < set(before)
    for name, value in after.items():
        np.testing.assert_array_equal(value, before[name])
    back = translate(moved, target, source)
    np.testing.assert_array_equal(source.constraints.unpack(back.lam_g)["contact"], 0)


@pytest.mark.parametrize("name", STRATEGIES)
def test_every_strategy_starts_at_sizes_of_the_problem_and_ends_tight(name: str) -> None:
    mu = get("cart-walls").natural_scales.mu
    paths = STRATEGIES[name].paths(mu)
    for path in paths:
        values = list(path.values)
        ordered = sorted(values, reverse=values[0] > values[-1])
        assert values == ordered and len(set(values)) == len(values)
        assert all(path.stage_at(value).value == value for value in values)


def test_the_table_of_a_solve_tells_the_whole_way() -> None:
    found = solve(get("push-1d"), Barrier(mu=1e-6), Direct(), settings={"homotopy_start": 0.01, "factor": 0.1})
    path = [line.value for line in found.stages if line.label == "mu"]
    np.testing.assert_allclose(path, np.geomspace(1e-2, 1e-6, 5))
    labels = [line.label for line in found.stages]
    assert labels[-1] == "from exact" and "active set" in labels
    np.testing.assert_array_equal(found.data["stage_value"], [line.value for line in found.stages])
    np.testing.assert_array_equal(found.data["stage_cost"], [line.cost for line in found.stages])
    assert found.iterations == sum(line.iterations for line in found.stages)
    assert found.data["stage_u"].shape == (6, 1, 20, 1)
    np.testing.assert_allclose(found.data["stage_u"][4], found.data["u"], atol=1e-5)
    np.testing.assert_allclose(found.data["stage_u"][5], found.data["u"], atol=1e-5)


def test_without_homotopy_there_is_one_stage() -> None:
    found = solve(get("push-1d"), Barrier(mu=1e-2), Direct(), settings={"homotopy": "false"})
    assert len(found.stages) == 1
    assert found.success
