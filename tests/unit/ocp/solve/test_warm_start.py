"""A solution carried to another program is feasible, optimal if the program is the same, and saves iterations."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import xarray as xr

from dynamics.contact import Adaptive, Barrier, Exact
from ocp import Direct, Feedback, InputError, MultipleShooting, OpenLoop, SingleShooting, solve
from ocp.problem.problem import FreeStart, Problem
from ocp.solution import Solution
from ocp.solve.solve import new_session
from ocp.solve.warm_start import carried_guess, carry
from ocp.transcription.nlp import NLP
from problems import get

METHODS = [Direct(), MultipleShooting(), SingleShooting()]


def stationarity(nlp: NLP, point: Any, values: dict[str, float]) -> float:
    """Return the largest entry of ``grad f + J' lam_g + lam_x``."""
    p = nlp.parameter_vector(values)
    slope = np.array(nlp.gradient(point.x, p)[1]).ravel()
    jacobian = nlp.jacobian(point.x, p)[1].sparse()
    return float(np.abs(slope + jacobian.T @ point.lam_g + point.lam_x).max())


@cache
def known_as(law: str = "barrier", method: str = "direct") -> Solution:
    laws = {"barrier": Barrier(mu=1e-3), "exact": Exact()}
    methods = {method.name: method for method in METHODS}
    return solve(get("push-disc"), laws[law], methods[method])


@pytest.fixture
def pushed() -> Solution:
    return known_as()


@pytest.mark.costly
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("policy", [OpenLoop(), Feedback()])
def test_the_same_nlp_gets_its_own_optimum_back(method, policy) -> None:
    problem = get("push-disc", scenarios=2, N=5)
    known = solve(problem, Barrier(mu=1e-3), method, policy)
    session = new_session(problem, Barrier(mu=1e-3), method, policy)
    nlp = session.nlp_of("product")
    point = carry(known, nlp, session.values)
    assert stationarity(nlp, point, session.values) < 1e-6
    p, bounds = nlp.parameter_vector(session.values), nlp.bounds(session.values)
    g = nlp.f_g(point.x, p)[1]
    assert np.all(np.array(g).ravel() <= bounds["ubg"] + 1e-7)
    assert np.all(np.array(g).ravel() >= bounds["lbg"] - 1e-7)


@pytest.mark.costly
def test_an_exact_optimum_satisfies_the_relaxed_conditions() -> None:
    """The multipliers of fixed pairs become those of the product, with the right signs."""
    known = known_as("exact")
    session = new_session(get("push-disc"), Exact())
    nlp = session.nlp_of("product")
    point = carry(known, nlp, session.values)
    assert stationarity(nlp, point, session.values) < 1e-6
    assert point.lam_g is not None and point.lam_x is not None
    assert np.all(point.lam_g[nlp.constraints["contact"].index] >= 0), "lam gap <= t"
    assert np.all(point.lam_x[nlp.pairs] <= 1e-9), "lam, gap >= 0"


@pytest.mark.cheap_cases("31", "40")
@pytest.mark.parametrize("N", [10, 13, 20, 31, 40])
def test_a_mesh_keeps_the_path_in_time(pushed: Solution, N: int) -> None:
    problem = get("push-disc", N=N, h=2.0 / N)
    session = new_session(problem, Barrier(mu=1e-3))
    nlp = session.nlp_of("product")
    blocks = nlp.variables.unpack(carry(pushed, nlp, session.values).x)
    times = 2.0 / N * np.arange(1, N + 1)
    for i in range(4):
        expected = np.interp(times, pushed.data["time"], pushed.data["x"][0, :, i])
        np.testing.assert_allclose(blocks["x"][0, :, i], expected, atol=1e-12)
    assert blocks["lam"] * blocks["gap"] == pytest.approx(1e-3, rel=1e-12)


def test_the_impulse_is_shared_out_among_more_steps(pushed: Solution) -> None:
    problem = get("push-disc", N=40, h=0.05)
    session = new_session(problem, Exact())
    nlp = session.nlp_of("product")
    lam = nlp.variables.unpack(carry(pushed, nlp, session.values).x)["lam"]
    old = pushed.data["lam"].values
    np.testing.assert_allclose(lam[0, 1::2], old[0] / 2, rtol=1e-12)
    assert lam.sum() == pytest.approx(old.sum(), rel=0.05)


def test_beyond_the_end_the_last_state_is_held_with_its_own_contact(pushed: Solution) -> None:
    problem = get("push-disc", N=25)
    session = new_session(problem, Barrier(mu=1e-3))
    nlp = session.nlp_of("product")
    blocks = nlp.variables.unpack(carry(pushed, nlp, session.values).x)
    x, u = pushed.data["x"].values[0], pushed.data["u"].values[0]
    np.testing.assert_allclose(blocks["x"][0, :20], x[1:], rtol=1e-14)
    np.testing.assert_allclose(blocks["x"][0, 20:], np.tile(x[-1], (5, 1)), rtol=1e-14)
    p = session.step.p.pack(session.values)
    lam = float(session.step.solve(x[-1], u[-1], p)[1])
    np.testing.assert_allclose(blocks["lam"][0, 20:, 0], lam, rtol=1e-6)


def test_a_shorter_horizon_cuts(pushed: Solution) -> None:
    problem = get("push-disc", N=12)
    session = new_session(problem, Barrier(mu=1e-3))
    point = carry(pushed, session.nlp_of("product"), session.values)
    blocks = session.nlp_of("product").variables.unpack(point.x)
    np.testing.assert_allclose(blocks["u"][0], pushed.data["u"].values[0, :12], rtol=1e-14)
    duals = session.nlp_of("product").constraints.unpack(point.lam_g)
    np.testing.assert_allclose(duals["dynamics"][0], pushed.data["lam_g_dynamics"].values[0, :12], rtol=1e-14)


@pytest.mark.costly
@pytest.mark.parametrize("settings", [{"N": 40, "h": 0.05}, {"N": 25}, {"M": 1.3}])
@pytest.mark.parametrize("law", [Barrier(mu=1e-3), Exact()])
def test_it_helps_and_the_answer_is_the_same(law, settings: dict[str, float]) -> None:
    known, cold = known_as(law.name), solve(get("push-disc", **settings), law)
    warm = solve(get("push-disc", **settings), law, warm_start=known)
    assert warm.success
    assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
    assert warm.iterations < cold.iterations * 0.75


@pytest.mark.costly
@pytest.mark.parametrize("target", METHODS)
@pytest.mark.parametrize("source", METHODS)
def test_between_methods_there_is_nothing_left_to_do(source, target) -> None:
    known = known_as(method=source.name)
    found = solve(get("push-disc"), Barrier(mu=1e-3), target, warm_start=known)
    assert found.success and found.iterations <= 3
    assert found.cost == pytest.approx(known.cost, rel=1e-8)


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-5), Adaptive(sigma=0.02)])
def test_between_laws(pushed: Solution, law) -> None:
    found = solve(get("push-disc"), law, warm_start=pushed)
    assert found.success
    assert found.cost == pytest.approx(0.10068, rel=1e-3)
    assert found.iterations < pushed.iterations / 2


def test_feedback_and_scenarios_start_from_one_open_loop_plan(pushed: Solution) -> None:
    problem = get("push-disc", scenarios=3)
    session = new_session(problem, Barrier(mu=1e-3), Direct(), Feedback())
    nlp = session.nlp_of("product")
    blocks = nlp.variables.unpack(carry(pushed, nlp, session.values).x)
    assert not blocks["K"].any()
    np.testing.assert_allclose(blocks["k"], pushed.data["u"].values[0], rtol=1e-14)
    for scenario in range(3):
        np.testing.assert_allclose(blocks["x"][scenario], pushed.data["x"][0, 1:], rtol=1e-14)
    assert solve(problem, Barrier(mu=1e-3), policy=Feedback(), warm_start=pushed).success


@pytest.mark.costly
def test_gains_move_with_the_mesh() -> None:
    known = solve(get("push-disc", scenarios=2, N=10), Barrier(mu=1e-2), policy=Feedback())
    N = known.data.sizes["interval"]
    problem = get("push-disc", scenarios=2, N=2 * N, h=known.values["h"] / 2)
    session = new_session(problem, Barrier(mu=1e-2), policy=Feedback())
    nlp = session.nlp_of("product")
    blocks = nlp.variables.unpack(carry(known, nlp, session.values).x)
    np.testing.assert_allclose(blocks["K"][1::2], known.data["K"].values, rtol=1e-12)


@pytest.mark.costly
def test_where_it_does_not_converge_the_usual_path_is_followed(
    pushed: Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ocp.routes import session as sessions

    resume = sessions.Session.resume
    monkeypatch.setattr(
        sessions.Session,
        "resume",
        lambda self, *a: replace(resume(self, *a), finished=False),
    )
    found = solve(get("push-disc", M=1.2), Barrier(mu=1e-3), warm_start=pushed)
    assert found.success
    assert "mu" in {stage.label for stage in found.stages}, "the law's own path"
    assert found.iterations == sum(stage.iterations for stage in found.stages)


def test_a_carried_guess_has_the_new_start(pushed: Solution) -> None:
    problem = get("push-disc", ox0=0.05)
    values = {p.name: p.value for p in problem.parameters}
    X, U = carried_guess(pushed, problem, values)
    assert X[0, 0] == 0.05
    np.testing.assert_allclose(X[1:], pushed.data["x"].values[0, 1:], rtol=1e-14)
    np.testing.assert_allclose(U, pushed.data["u"].values[0], rtol=1e-14)


def free_start(**params: float) -> Problem:
    problem = get("push-disc", **params)
    at = ca.SX(problem.x0)
    return replace(problem, start=FreeStart(at - 0.1, at + 0.1))


@pytest.mark.costly
def test_a_chosen_start_is_carried_with_its_multipliers() -> None:
    known = solve(free_start(N=10), Barrier(mu=1e-3))
    session = new_session(free_start(N=10), Barrier(mu=1e-3))
    nlp = session.nlp_of("product")
    point = carry(known, nlp, session.values)
    x0 = nlp.variables.unpack(point.x)["x0"]
    np.testing.assert_allclose(x0[0, 0], known.data["x"][0, 0], rtol=1e-14)
    assert np.abs(x0[0, 0] - np.array([0, 0, -1, 0.2])).max() > 0.05, "it was worth choosing"
    assert stationarity(nlp, point, session.values) < 1e-6
    warm = solve(free_start(N=20, h=0.05), Barrier(mu=1e-3), warm_start=known)
    assert warm.success and warm.iterations < known.iterations


def test_a_step_size_that_is_a_state_shrinks_with_a_finer_mesh() -> None:
    problem = get("half-cheetah", N=6)
    column = [signal.name for signal in problem.system.states].index("h")
    noise = np.random.default_rng(2)
    x, u = noise.random((1, 4, problem.system.nx)), noise.random((1, 3, problem.system.nu))
    x[..., column] = 0.03
    data = xr.Dataset(
        {
            "x": (("scenario", "node", "state"), x),
            "u": (("scenario", "interval", "control"), u),
            "time": ("node", 0.03 * np.arange(4)),
        }
    )
    known = replace(known_as().with_data(data), problem=problem)
    values = {p.name: p.value for p in problem.parameters}
    X, _ = carried_guess(known, problem, values)
    np.testing.assert_allclose(X[:, column], 0.015, rtol=1e-12)
    others = [i for i in range(problem.system.nx) if i != column]
    np.testing.assert_allclose(X[::2, others], x[0][:, others], rtol=1e-9)


def test_without_multipliers_the_point_is_primal_and_still_helps(pushed: Solution) -> None:
    names = [name for name in pushed.data if str(name).startswith(("lam_g_", "lam_x_"))]
    assert names
    bare = pushed.with_data(pushed.data.drop_vars(names))
    session = new_session(get("push-disc"), Barrier(mu=1e-3))
    assert carry(bare, session.nlp_of("product"), session.values).lam_g is None
    assert solve(get("push-disc"), Barrier(mu=1e-3), warm_start=bare).iterations <= 3


def test_what_does_not_fit_is_refused(pushed: Solution) -> None:
    with pytest.raises(InputError, match="of push-disc, not of push-1d"):
        solve(get("push-1d"), Barrier(mu=1e-3), warm_start=pushed)
    other = pushed.with_data(pushed.data.assign_coords(state=["a", "b", "c", "d"]))
    with pytest.raises(InputError, match="has states a, b, c, d, but push-disc has ox, oy"):
        solve(get("push-disc"), Barrier(mu=1e-3), warm_start=other)
    lost = pushed.with_data(pushed.data.assign(x=pushed.data["x"] * np.nan))
    with pytest.raises(InputError, match="NaN or infinite"):
        solve(get("push-disc"), Barrier(mu=1e-3), warm_start=lost)
    with pytest.raises(InputError, match="several starts"):
        solve(get("push-disc"), Barrier(mu=1e-3), warm_start=pushed, n_starts=2)
