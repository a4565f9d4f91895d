"""Continuation over a parameter: one NLP, warm starts, halved steps, and breaks with their reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, Exact
from ocp import Constraint, Direct, InputError, MultipleShooting, SingleShooting, solve
from ocp.continuation import Continuation, CurvePoint, continue_over, curve_dataset, resolve
from ocp.continuation.tracking import Tracker
from ocp.routes.session import Session
from ocp.solve.solve import new_session
from problems import get


def barrier_session(name: str = "push-1d", mu: float = 1e-2, **params: float) -> Session:
    return new_session(get(name, **params), Barrier(mu=mu), Direct())


def costs(path: Continuation) -> list[float]:
    return [point.solution.cost for point in path.points]


@pytest.mark.costly
def test_a_sweep_of_mu_costs_a_sixth_of_cold_solves_at_most() -> None:
    session = barrier_session("push-disc", 1.0)
    path = continue_over(session, "contact.mu", 1.0, 1e-8, 20, "log")
    values = np.geomspace(1.0, 1e-8, 21)
    assert path.break_reason is None
    assert path.nlp_builds == 1, "a start so wide needs no exact law's answer"
    np.testing.assert_allclose([point.value for point in path.points], values, rtol=1e-9)
    assert path.points[-1].value == 1e-8, "the end is exactly what was asked"
    assert all(point.solution.success for point in path.points)
    assert path.iterations >= sum(point.solution.iterations for point in path.points)
    cold = [solve(get("push-disc"), Barrier(mu=mu), Direct()) for mu in values]
    assert path.iterations <= sum(found.iterations for found in cold) / 6
    np.testing.assert_allclose(costs(path), [found.cost for found in cold], rtol=1e-6)
    for point in path.points:
        assert point.solution.audit.complementarity == pytest.approx(point.value, rel=1e-4)


@pytest.mark.costly
@pytest.mark.parametrize("law", [Barrier(mu=1e-2), Exact()])
def test_builds_count_every_nlp_and_do_not_grow_along_the_path(law, monkeypatch) -> None:
    """The count includes the law's NLPs and those of the exact law, whose solution starts the first point."""
    built: list[str] = []
    transcribe = Direct.transcribe

    def counting(method, graph, reformulation="product", *rest):
        built.append(f"{graph.step.law.name} {reformulation}")
        return transcribe(method, graph, reformulation, *rest)

    monkeypatch.setattr(Direct, "transcribe", counting)
    for steps in (1, 6):
        built.clear()
        session = new_session(get("push-1d"), law, Direct())
        path = continue_over(session, "M", 1.0, 1.1, steps)
        assert path.break_reason is None
        assert path.nlp_builds == len(built) > 1
        assert len(set(built)) == len(built)


@pytest.mark.costly
def test_a_physical_parameter_moves_the_start_and_the_bounds_with_it() -> None:
    """Every point's solution equals that of a problem built at the point's value."""
    for over, end in (("qa0", -0.3), ("u_max", 0.6), ("problem.M", 3.0)):
        session = barrier_session()
        start = session.values[over.removeprefix("problem.")]
        path = continue_over(session, over, start, end, 3)
        assert path.break_reason is None
        name = over.removeprefix("problem.")
        for point in path.points[1:]:
            built = solve(get("push-1d", **{name: point.value}), Barrier(mu=1e-2), Direct())
            assert point.solution.cost == pytest.approx(built.cost, rel=1e-6)
            assert point.solution.values[name] == point.value
        x0 = path.points[-1].solution.data["x"].values[0, 0]
        np.testing.assert_allclose(x0, [0, -0.3 if over == "qa0" else -0.5])
        assert path.nlp_builds == 3


@pytest.mark.costly
@pytest.mark.parametrize("method", [MultipleShooting(), SingleShooting()])
def test_shooting_follows_the_same_path(method) -> None:
    direct = continue_over(barrier_session(), "contact.mu", 1e-2, 1e-4, 4, "log")
    session = new_session(get("push-1d"), Barrier(mu=1e-2), method)
    path = continue_over(session, "contact.mu", 1e-2, 1e-4, 4, "log")
    np.testing.assert_allclose(costs(path), costs(direct), rtol=1e-6)


@pytest.mark.costly
def test_the_adaptive_laws_sigma_can_be_followed() -> None:
    session = new_session(get("push-1d"), Adaptive(sigma=0.2), Direct())
    path = continue_over(session, "contact.sigma", 0.2, 0.02, 5, "log")
    assert path.break_reason is None
    last = solve(get("push-1d"), Adaptive(sigma=0.02), Direct())
    assert costs(path)[-1] == pytest.approx(last.cost, rel=1e-6)


@pytest.mark.costly
def test_the_exact_law_can_be_followed_in_direct() -> None:
    session = new_session(get("push-1d"), Exact(), Direct())
    path = continue_over(session, "goal_x", 1.0, 0.6, 4)
    assert path.break_reason is None
    assert all(point.solution.audit.complementarity <= 1e-8 for point in path.points)
    built = solve(get("push-1d", goal_x=0.6), Exact(), Direct())
    assert costs(path)[-1] == pytest.approx(built.cost, rel=1e-6)


@pytest.mark.costly
def test_a_step_that_fails_is_halved_and_grows_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without prediction along a curve, a solver fails for steps longer than 0.03 between M = 1.2 and M = 1.5."""
    session = barrier_session()
    steps, plain = [], Session.solve

    def refuse(self: Session, start=None, warm_from=None, **more):
        found = plain(self, start=start, warm_from=warm_from, **more)
        if self is not session:
            return found
        M = self.values["M"]
        if start is None:
            steps.append((M, True))
            return found
        last = next(value for value, good in reversed(steps) if good)
        good = not (1.2 < M < 1.5 and M - last > 0.03)
        steps.append((M, good))
        return found if good else replace(found, finished=False)

    monkeypatch.setattr(Session, "solve", refuse)
    monkeypatch.setattr(Tracker, "start_at", lambda *_: None)
    path = continue_over(session, "M", 1.0, 2.0, 10)
    assert path.break_reason is None
    values = [point.value for point in path.points]
    assert values == [value for value, good in steps if good]
    assert values[-1] == 2.0
    asked, taken = 0.1, np.diff(values)
    assert taken.min() == pytest.approx(asked / 4), "0.1 and 0.05 are too long, 0.025 is not"
    assert taken.max() <= asked * (1 + 1e-9), "never longer than asked"
    assert taken[-1] == pytest.approx(asked), "after the hard part the step has grown back"
    first_bad = next(i for i, (_, good) in enumerate(steps) if not good)
    assert steps[first_bad + 1][0] == pytest.approx((steps[first_bad - 1][0] + steps[first_bad][0]) / 2)


@pytest.mark.costly
def test_a_path_that_ends_is_told_with_where_and_why() -> None:
    """In six steps the object cannot be pushed beyond the actuator's reach."""
    problem = get("push-1d", N=6, goal_x=0.5, u_max=1.0)
    reach = Constraint("reach", problem.system.x[0] - problem.parameters["goal_x"], 0.0, 10.0)
    session = new_session(replace(problem, terminal=(reach,)), Barrier(mu=1e-3), Direct())
    path = continue_over(session, "goal_x", 0.5, 3.0, 5)
    assert path.break_reason is not None
    assert path.points, "what was solved is kept"
    assert all(point.solution.success for point in path.points)
    last = path.points[-1].value
    assert 1.0 < last < 1.5, "the bound of 1 m on the pusher, its width, and the barrier's force"
    assert f"{last:g}" in path.break_reason
    assert "goal_x" in path.break_reason
    assert "Worst:" in path.break_reason


@pytest.mark.costly
def test_a_first_point_that_fails_is_told() -> None:
    problem = get("push-1d", N=6)
    reach = Constraint("reach", problem.system.x[0], 50.0, 60.0)
    session = new_session(replace(problem, terminal=(reach,)), Barrier(mu=1e-3), Direct())
    path = continue_over(session, "M", 1.0, 2.0, 4)
    assert path.break_reason is not None
    assert path.break_reason.startswith("at the first point, M = 1")


@pytest.mark.costly
def test_progress_is_told_point_by_point() -> None:
    seen: list[CurvePoint] = []
    path = continue_over(barrier_session(), "M", 1.0, 1.2, 2, progress=seen.append)
    assert [point.value for point in seen] == [point.value for point in path.points]


@pytest.mark.costly
def test_all_trajectories_end_in_one_dataset() -> None:
    path = continue_over(barrier_session(), "M", 1.0, 2.0, 2)
    data = curve_dataset(path)
    np.testing.assert_allclose(data["value"], [1.0, 1.5, 2.0])
    np.testing.assert_allclose(data["cost"], costs(path))
    for i, point in enumerate(path.points):
        np.testing.assert_array_equal(data["x"].values[i], point.solution.data["x"].values)
        row = point.row()
        assert row["exact_cost"] == float(data["exact_cost"][i])
        assert row["success"]
        assert row["status"] == "solved"


def test_names_are_found_with_and_without_prefix() -> None:
    session = barrier_session()
    assert resolve(session, "contact.mu") == "contact.mu"
    assert resolve(session, "M") == resolve(session, "problem.M") == "M"
    with pytest.raises(InputError, match=r"unknown parameter 'mass'.*contact\.mu"):
        resolve(session, "mass")


@pytest.mark.parametrize(
    ("over", "start", "end", "steps", "scale", "sentence"),
    [
        ("mass", 1, 2, 3, "linear", "unknown parameter 'mass'"),
        ("M", 1, 1, 3, "linear", "must be finite and differ"),
        ("M", 1, float("nan"), 3, "linear", "must be finite and differ"),
        ("M", float("inf"), 1, 3, "linear", "must be finite and differ"),
        ("M", 1, 2, 0, "linear", "steps must be a whole number >= 1"),
        ("M", 0, 2, 3, "log", "positive ends"),
        ("M", 1, -2, 3, "log", "positive ends"),
        ("M", -1, -2, 3, "log", "positive ends"),
        ("M", 1, 2, 3, "cubic", "unknown scale"),
    ],
)
def test_bad_input_gets_its_sentence(over, start, end, steps, scale, sentence) -> None:
    with pytest.raises(InputError, match=sentence):
        continue_over(barrier_session(), over, start, end, steps, scale)
