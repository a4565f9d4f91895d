"""The optimum that each problem file states is the one that is found."""

from __future__ import annotations

import pytest

import problems
from dynamics.contact import Barrier, Exact
from ocp import Direct, solve

LAWS = {"exact": Exact(), "barrier mu=1e-3": Barrier(mu=1e-3)}
STATED = [(name, key) for name in problems.names()[:5] for key in problems.spec(name).golden]


def test_every_problem_states_its_exact_and_its_barrier_optimum():
    assert len(STATED) == 5 * len(LAWS)


@pytest.mark.parametrize(("name", "key"), STATED)
def test_the_stated_optimum_is_found(name: str, key: str):
    golden = problems.spec(name).golden[key]
    found = solve(problems.get(name), LAWS[key], Direct(), starts=golden.starts)
    assert golden.law == LAWS[key].name
    assert golden.method == "direct"
    assert found.success
    assert found.cost == pytest.approx(golden.cost, rel=golden.tolerance)
