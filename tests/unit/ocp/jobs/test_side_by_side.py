"""Sweeps in processes: the same data from one, from two, with a killed worker, and resumed."""

from __future__ import annotations

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from ocp.errors import InputError
from ocp.jobs import sweep_job
from ocp.jobs.grid import parse_axes
from ocp.jobs.scheduling import Workers
from ocp.jobs.sweep import make_grid, solve_grid, sweep
from ocp.jobs.sweep_job import JobResult, solve_starts
from ocp.solve.solve_request import SolveRequest
from ocp.solve.starts import solve_session
from tests.unit.ocp.jobs.same import same

OVER = {"M": [0.5, 1.0, 2.0], "contact.mu": [1e-3, 1e-2]}
SHORT = {"N": 6}


@pytest.mark.costly
def test_one_process_or_two_or_one_killed_on_the_way_give_the_same_bits() -> None:
    alone = sweep("push-1d", OVER, "barrier", params=SHORT)
    killed: list[int] = []

    def kill_one(*_: object) -> None:
        workers = multiprocessing.active_children()
        if not killed and len(workers) == 2:
            pid = workers[0].pid
            assert pid is not None
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    beside = sweep("push-1d", OVER, "barrier", params=SHORT, jobs=2, progress=kill_one)
    assert killed
    assert same(alone, beside)


class Stop(Exception):
    pass


@pytest.mark.costly
def test_a_sweep_that_stopped_goes_on_and_ends_as_if_it_had_not(tmp_path: Path) -> None:
    ended: list[int] = []

    def stop(index: int, _: JobResult) -> None:
        ended.append(index)
        if len(ended) == 3:
            raise Stop

    with pytest.raises(Stop):
        sweep("push-1d", OVER, "barrier", params=SHORT, store=tmp_path, progress=stop)
    again: list[int] = []
    whole = sweep(
        "push-1d",
        OVER,
        "barrier",
        params=SHORT,
        store=tmp_path,
        progress=lambda index, _: again.append(index),
    )
    assert sorted([*ended, *again]) == list(range(6)) and len(again) == 3
    assert same(whole, sweep("push-1d", OVER, "barrier", params=SHORT))
    assert not list(tmp_path.rglob(".unfinished-*"))


@pytest.mark.costly
def test_what_is_kept_belongs_to_one_sweep_and_a_broken_file_is_not_kept(tmp_path: Path) -> None:
    def stop(*_: object) -> None:
        raise Stop

    with pytest.raises(Stop):
        sweep("push-1d", {"M": [1.0, 2.0]}, params=SHORT, store=tmp_path, progress=stop)
    other: list[int] = []
    sweep(
        "push-1d",
        {"M": [1.0, 2.0]},
        params=SHORT,
        seed=1,
        store=tmp_path,
        progress=lambda index, _: other.append(index),
    )
    assert other == [0, 1]
    (arrays,) = tmp_path.rglob("arrays-00000.npz")
    arrays.write_bytes(arrays.read_bytes()[:100])
    again: list[int] = []
    sweep("push-1d", {"M": [1.0, 2.0]}, params=SHORT, store=tmp_path, progress=lambda index, _: again.append(index))
    assert again == [0, 1]


@pytest.mark.costly
def test_starts_side_by_side_are_starts_one_after_another() -> None:
    case = SolveRequest("push-1d", SHORT, "exact")
    session = case.session()
    alone = solve_session(session, 3, 5, rank_by="exact")
    beside = solve_starts(case.session(), case, 3, 5, rank_by="exact", workers=Workers(2))
    untimed = [[replace(attempt, seconds=0.0) for attempt in found.route.attempts] for found in (beside, alone)]
    assert untimed[0] == untimed[1] and len(untimed[1]) == 3
    chosen = next(one for one in alone.route.attempts if one.chosen)
    least = min(one.exact_cost for one in alone.route.attempts if one.status == "solved")
    assert chosen.exact_cost == least
    assert (beside.cost, beside.iterations) == (alone.cost, alone.iterations)
    drop = ["stage_seconds"]
    assert beside.data.drop_vars(drop).identical(alone.data.drop_vars(drop))
    assert beside.sensitivity("M").identical(alone.sensitivity("M"))


def test_fewer_than_one_process_is_refused() -> None:
    with pytest.raises(InputError, match="jobs must be a whole number >= 1 and <= 1024, got 0"):
        sweep("push-1d", {"M": [1.0, 2.0]}, params=SHORT, jobs=0)


def test_ctrl_c_that_compiled_code_took_for_a_failure_is_no_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NumPy turns Ctrl-C into a SystemError, IPOPT into a failed solve; neither may be stored."""

    def taken(*_: object, **__: object) -> None:
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(sweep_job, "solve_session", taken)
    with pytest.raises(KeyboardInterrupt):
        sweep("push-1d", {"M": [1.0, 2.0]}, params=SHORT, store=tmp_path)
    assert not list(tmp_path.rglob("point-*.json"))
    monkeypatch.undo()
    study = make_grid(SolveRequest("push-1d", SHORT), parse_axes({"M": [1.0, 2.0]}))
    checkpoint = study.checkpoint(tmp_path, study.check().problem.name)

    def stop(_: int, message: object) -> None:
        if message is None:
            raise KeyboardInterrupt

    with checkpoint, pytest.raises(KeyboardInterrupt):
        solve_grid(study, files=checkpoint, callback=stop)
    assert not list(tmp_path.rglob("point-*.json"))
