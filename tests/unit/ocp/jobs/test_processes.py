"""Jobs in parallel processes: each is done once, reports progress, and is repeated if its worker dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from ocp.errors import InputError
from ocp.jobs import processes
from ocp.jobs.scheduling import Failure, run_jobs
from tests.unit.ocp.jobs.jobs_done import kept, squared

ROOT = Path(__file__).parents[4]


@pytest.mark.costly_cases("2")
@pytest.mark.parametrize("workers", [1, 2])
def test_each_job_is_done_and_heard(workers: int) -> None:
    heard: list[tuple[int, Any]] = []
    jobs = [{"x": float(x)} for x in range(5)]
    done = dict(run_jobs(squared, jobs, workers, callback=lambda *news: heard.append(news)))
    assert [done[index]["square"][0] for index in range(5)] == [0.0, 1.0, 4.0, 9.0, 16.0]
    told = {(index, message["k"], message["x"]) for index, message in heard}
    assert told == {(index, k, float(index)) for index in range(5) for k in range(2)}
    processes = {result["process"] for result in done.values()}
    assert (processes == {os.getpid()}) if workers == 1 else (os.getpid() not in processes)
    assert len(processes) <= workers


@pytest.mark.costly_cases("2")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_job_that_fails_stops_no_other(workers: int) -> None:
    jobs = [{"x": 1.0, "fails": True}, {"x": 2.0}, {"x": 3.0}]
    done = dict(run_jobs(squared, jobs, workers))
    assert isinstance(done[0], Failure) and isinstance(done[0].error, InputError)
    assert str(done[0].error) == "x = 1.0 is refused"
    assert [done[index]["square"][0] for index in (1, 2)] == [4.0, 9.0]


@pytest.mark.costly
def test_a_job_whose_worker_dies_is_begun_again(tmp_path: Path) -> None:
    jobs: list[dict[str, Any]] = [{"x": float(x)} for x in range(4)]
    jobs[1] |= {"dies": str(tmp_path / "once"), "deaths": 1}
    jobs[2] |= {"dies": str(tmp_path / "always"), "deaths": 99}
    done = dict(run_jobs(squared, jobs, 2))
    assert [done[index]["square"][0] for index in (0, 1, 3)] == [0.0, 1.0, 9.0]
    assert isinstance(done[2], Failure) and "worker died" in str(done[2].error)
    assert [(tmp_path / name).read_text() for name in ("once", "always")] == ["++", "+++"]


@pytest.mark.costly
def test_workers_may_keep_what_they_did_when_the_caller_stops(tmp_path: Path) -> None:
    jobs = [{"note": str(tmp_path / name)} for name in "ab"]
    indices = set()

    def heard(index: int, _: Any) -> None:
        indices.add(index)
        if len(indices) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), closing(run_jobs(kept, jobs, 2, callback=heard)) as run:
        list(run)
    assert [(tmp_path / name).read_text() for name in "ab"] == ["kept", "kept"]


@pytest.mark.costly
def test_a_worker_that_is_starting_as_the_caller_stops_ends_by_itself() -> None:
    """A starting worker ignores the signal of Ctrl-C, as do all workers of a shell that ignores it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        worker = processes._Worker.start(squared)
    finally:
        signal.signal(signal.SIGINT, before)
    worker.give(0, [{"x": 1.0}])
    processes._stop_workers([worker])
    assert worker.process.exitcode == 0, "it was killed after the time of grace"


@pytest.mark.costly
def test_workers_end_with_a_caller_that_was_killed(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    code = (
        "from ocp.jobs.scheduling import run_jobs\n"
        "from tests.unit.ocp.jobs.jobs_done import squared\n"
        f"jobs = [{{'x': 1.0, 'steps': 10**6, 'wait': 0.02, 'mark': {str(mark)!r}}}] * 2\n"
        "list(run_jobs(squared, jobs, 2))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    caller = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, env=environment)
    try:
        waited = time.monotonic() + 60
        while not mark.exists() and time.monotonic() < waited:
            time.sleep(0.05)
        assert mark.exists()
    finally:
        caller.send_signal(signal.SIGKILL)
        caller.wait(60)
    time.sleep(1.0)
    before = mark.stat().st_size
    time.sleep(0.5)
    assert mark.stat().st_size == before


@pytest.mark.costly
def test_a_script_needs_no_guard_and_workers_keep_to_one_thread(tmp_path: Path) -> None:
    """Workers do not run the script again, which would start more workers and fails for a script from a pipe."""
    script = (
        "print('begun')\n"
        "from ocp.jobs.scheduling import run_jobs\n"
        "from tests.unit.ocp.jobs.jobs_done import threads\n"
        "print(sorted(found for _, found in run_jobs(threads, [1, 2], 2)))\n"
    )
    environment = {key: value for key, value in os.environ.items() if "NUM_THREADS" not in key}
    environment |= {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "3"}
    (tmp_path / "script.py").write_text(script)
    for words, given in (("script.py", None), ("-", script)):
        done = subprocess.run(
            [sys.executable, words],
            input=given,
            text=True,
            capture_output=True,
            cwd=tmp_path,
            env=environment,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines() == ["begun", "[('1', '3'), ('1', '3')]"]


def test_fewer_than_one_worker_is_refused() -> None:
    with pytest.raises(InputError, match="jobs must be a whole number >= 1 and <= 1024, got 0"):
        run_jobs(squared, [{"x": 1.0}], 0)


@pytest.mark.costly
@pytest.mark.parametrize("seconds", [0.0, 0.2, 0.8])
def test_ctrl_c_while_workers_start_is_silent(seconds: float) -> None:
    """A terminal also sends the signal to the workers, which import modules for about a second."""
    program = (
        "from ocp.jobs.scheduling import run_jobs\n"
        "from tests.unit.ocp.jobs.jobs_done import squared\n"
        "print('ready', flush=True)\n"
        "try:\n    list(run_jobs(squared, [{'x': 1.0}] * 4, 2))\n"
        "except KeyboardInterrupt:\n    print('stopped')\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=ROOT,
        start_new_session=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert err == ""
    assert out in ("stopped\n", "")
