"""Several relaxations of one problem, and second ways that are given up in time."""

from __future__ import annotations

import pytest

from dynamics.contact import Exact
from ocp.programs.status import Status
from ocp.routes.complementarity import Route, by_strategy
from ocp.routes.legs import Homotopy
from ocp.routes.relaxations import CentralPath
from ocp.solve import new_session, solve
from problems import get
from tests.benchmarks.ocp.random_draws import drawn

WALLS = {"mc": 2.2205, "mp": 0.0932, "l": 0.4108, "wall": 0.3335, "k": 106.0, "h": 0.033,
         "w_end": 90.53, "u_max": 2.3294}  # fmt: skip


def test_a_second_look_finds_the_better_minimum() -> None:
    *_, instance = drawn("cart-transport", 6, 0)
    session = new_session(get(instance.problem, **instance.params), Exact())
    follower = Homotopy(session.nlp_of, session.solver, session.values)
    route = Route([CentralPath()], session.problem.reference, session.first_point)
    alone = by_strategy(follower, route, route.looks[0])[0].f
    found = solve(get(instance.problem, **instance.params))
    assert found.success and found.cost < 0.9 * alone
    assert found.cost == pytest.approx(6.3313, rel=1e-4)


def test_a_look_that_meets_a_known_active_set_is_the_last_one() -> None:
    outcome = new_session(get("wall-1d"), Exact()).solve()
    landings = [record for record in outcome.trace.records if record.knob == "active set"]
    assert len(landings) == 1 and outcome.finished


def test_several_starts_take_other_relaxations_and_reach_other_minima() -> None:
    found = solve(get("cart-walls", **WALLS), starts=2)
    assert found.success and found.cost == pytest.approx(289.151, rel=1e-5)


def test_runs_past_a_deadline_are_given_up_and_the_limit_ends_with_its_block() -> None:
    session = new_session(get("wall-1d"), Exact())
    with session.solver.within(0.0):
        late = session.solve()
    assert late.result.status is Status.TIME_LIMIT and not late.finished
    assert late.trace.iterations == 0
    with session.solver.within(0.0), session.solver.within(None):
        pass
    assert session.solver.deadline is None and session.solve().finished
