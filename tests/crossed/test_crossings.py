"""Every combination of options on every problem gives a verdict, or one sentence that says why not."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ocp import solve
from ocp.errors import InputError
from ocp.mpc import Controller, simulate
from ocp.problem.problem import Problem
from ocp.programs.solver import Status
from ocp.solution import Solution
from ocp.transcription.factories import make_law
from problems import get, names
from tests.cli.conftest import Done, ocp  # noqa: F401
from tests.crossed.ways import CROSSINGS, LONG_BUILDS, PROBLEMS, STRANGERS, Crossing

DRAWN, DRAWN_COSTLY = 30, 400
"""Inverse shares of the cases that are in ``make test``: of all problems, and of costly ones."""
LINES = 10
"""Inverse share of the cases that are also run from the command line."""
DONE, BAD_INPUT, NOT_CONVERGED = 0, 2, 3


def cases(purpose: str = "") -> Iterator[object]:
    """Yield all crossings, or those drawn for a purpose; those outside the quick share are marked slow."""
    for crossing in CROSSINGS:
        if purpose and not crossing.drawn(LINES, f"tried {purpose}"):
            continue
        quick = crossing.drawn(DRAWN_COSTLY if crossing.costly else DRAWN, purpose)
        quick = quick and crossing.problem not in LONG_BUILDS
        marks = [] if quick else [pytest.mark.slow]
        yield pytest.param(crossing, id=crossing.name, marks=marks)


@pytest.fixture(autouse=True)
def _without_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide the compiler, since closed loops of two samples do not pay for seconds of compilation."""
    monkeypatch.setenv("PATH", str(tmp_path))


@cache
def smallest(crossing_problem: str, N: int) -> Problem:
    return get(crossing_problem, N=N)


@contextlib.contextmanager
def one_sentence() -> Iterator[None]:
    """Check that an input error in the block has a message of one sentence; other errors propagate."""
    try:
        yield
    except InputError as error:
        sentence = str(error)
        assert len(sentence) > 20
        assert "\n" not in sentence
        assert "Traceback" not in sentence


def is_verdict(found: Solution) -> None:
    """Check that a solution has a known status, finite numbers if it succeeded, and else a sentence on its failure."""
    assert isinstance(found.status, Status)
    assert found.verdict.strip().endswith(".")
    assert found.success == (found.status is Status.SOLVED)
    assert found.data["x"].shape[1] == found.problem.N + 1
    assert not found.route.failures
    if found.success:
        numbers = [found.cost, found.audit.exact_cost, *(found.data[k].values for k in ("x", "u"))]
        assert all(np.isfinite(one).all() for one in numbers)
        assert "nan" not in found.verdict
        assert found.certificate.certified


def try_loop(problem: Problem, phase: str = "qpcc", contact: str = "own", plant: str = "exact"):
    """Simulate two samples of a closed loop; check that commands are within bounds, and costs finite or ended early."""
    law = None if contact == "own" else make_law(contact, {}, problem.system)
    controller = Controller(problem, law, phase)
    loop = simulate(controller, 2, plant, certify=1)
    low, high = (np.array(v).ravel() for v in problem.limits(problem.parameters.values)[2:4])
    u = loop.data["u"].values
    if plant != "noise":
        assert np.all((u >= low - 1e-6) & (u <= high + 1e-6))
    assert np.isfinite(loop.costs).all() or not loop.survived.all()


@pytest.mark.parametrize("crossing", cases())
def test_a_way_on_a_problem_gives_a_verdict_or_a_sentence(crossing: Crossing) -> None:
    problem, way = smallest(crossing.problem, **crossing.params), crossing.way
    with one_sentence():
        if way.loop:
            try_loop(problem, **way.loop)
            return
        found = solve(problem, **crossing.arguments)
        is_verdict(found)
        if way.world:
            assert found.replay_in(way.world).sentence


@pytest.mark.parametrize("crossing", cases("as a command line"))
def test_a_way_on_a_problem_ends_with_its_exit_code(
    crossing: Crossing,
    ocp,  # noqa: F811
    tmp_path: Path,
) -> None:
    done: Done = ocp(*crossing.words, "--json", "--out", str(tmp_path / "runs"))
    assert done.code in (DONE, BAD_INPUT, NOT_CONVERGED), done.err
    assert "Traceback" not in done.err
    assert "bug" not in done.err
    if done.code == BAD_INPUT:
        assert done.err.count("\n") == 1
        assert not done.out
    else:
        assert json.loads(done.out)["verdict"]


def test_the_strangers_are_problems() -> None:
    assert len(STRANGERS) >= 10
    assert len({get(str(file), N=3).name for file in STRANGERS} | {*names()}) == len(PROBLEMS)
