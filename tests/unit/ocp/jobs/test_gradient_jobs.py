"""Simulators measured side by side: the same bits, failures that lose nothing else, and changed files."""

from __future__ import annotations

from pathlib import Path

import pytest
from distributed import LocalCluster

from ocp import gradient_report
from ocp.errors import InputError
from ocp.gradients.worlds import ReportSettings
from ocp.jobs.gradients import WorldJob, measure_world, measure_worlds
from ocp.jobs.scheduling import Workers
from ocp.store.checkpoint import SavedWork
from ocp.store.provenance import FilesChanged
from problems.gradient_scenes.cases import gradient_case

SINE = """import numpy as np, os
theta = [0.7]
def rollout(theta, h=0.1):
    return np.sin(theta) + 0 * h
truth = rollout
sharper = {"h": 0.5}
"""
ENDS = SINE.replace("    return", "    if len(theta) > 10: os._exit(7)\n    return")
FEW = ReportSettings(samples=200)


def written(folder: Path, **files: str) -> list[str]:
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text)
    return [str(folder / f"{name}.py") for name in files]


@pytest.mark.costly
def test_any_number_of_jobs_gives_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of the simulators is a file that is named relative to the folder in which the command runs."""
    written(tmp_path, sine=SINE)
    monkeypatch.chdir(tmp_path)
    names = ("exact", "penalty", "sine.py")
    alone, beside = (gradient_report("two-balls", names, samples=200, jobs=jobs).rows for jobs in (1, 3))
    assert alone == beside and {row["status"] for row in alone} == {"done"}


@pytest.mark.slow
def test_a_cluster_gives_the_same_bits() -> None:
    alone = gradient_report("two-balls", ["exact", "penalty"], samples=200).rows
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        address = cluster.scheduler_address
        assert gradient_report("two-balls", ["exact", "penalty"], samples=200, scheduler=address).rows == alone


@pytest.mark.costly
def test_a_simulator_that_ends_its_process_does_not_lose_the_others(tmp_path: Path) -> None:
    sine, ends = written(tmp_path, sine=SINE, ends=ENDS)
    case = gradient_case(sine, [ends])
    job, files = WorldJob(sine, (ends,), settings=FEW, content=case.content), SavedWork(tmp_path)
    rows = measure_worlds(case.worlds, case.questions, FEW, files, workers=Workers(2), job=job).rows
    assert [row["verdict"] for row in rows] == ["right", "failed"] and "worker died" in rows[1]["sentence"]
    assert files.rows(0) == rows[:1] and files.rows(1) is None


def test_a_file_that_changes_between_two_jobs_ends_the_measurements(tmp_path: Path) -> None:
    (sine,) = written(tmp_path, sine=SINE)
    job = WorldJob(sine, settings=FEW, content=gradient_case(sine).content)
    assert measure_world(job, lambda text: None)["verdict"] == "right"
    written(tmp_path, sine=SINE.replace("0.1", "0.2"))
    with pytest.raises(FilesChanged, match="has changed since"):
        job.build()


def test_functions_are_measured_in_one_process() -> None:
    with pytest.raises(InputError, match="drop jobs"):
        gradient_report(lambda theta: theta, theta=1.0, jobs=2)
