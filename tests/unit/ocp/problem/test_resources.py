"""Predicted time and memory of a task: reported before it starts, and close to the real ones."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from dynamics.contact import Barrier, Randomized
from ocp import Feedback, solve
from ocp.errors import InputError
from ocp.gradients.estimation import Sampling
from ocp.gradients.sweep import SweepRun
from ocp.problem import resources
from problems import get
from problems.registry import objective_spec

PEAK = """
import resource, sys
from dynamics.contact import Barrier, Randomized
from ocp import solve
from problems import get
solve(get(sys.argv[1], N=int(sys.argv[2])), Barrier(mu=1e-2), settings={"max_iter": 3})
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


def test_memory_grows_with_steps_and_scenarios_alike() -> None:
    one = resources.solve_memory(get("push-disc", N=10, scenarios=1))
    assert resources.solve_memory(get("push-disc", N=70, scenarios=3)) == pytest.approx(21 * one)


def test_feedback_adds_its_gains_to_a_stage_and_noise_its_nodes_to_a_program() -> None:
    problem, law = get("push-disc", N=10, scenarios=3), Randomized(samples=8)
    nx, nu, nlam = problem.system.nx, problem.system.nu, problem.system.nlam
    assert resources.stage_size(problem) == nx + nu + 2 * nlam
    assert resources.stage_size(problem, Feedback()) == nx + nu + 2 * nlam + nu * (nx + 1)
    assert resources.solve_memory(problem, None, law) == 8 * resources.solve_memory(problem)
    assert resources.solve_seconds(problem, path=1000) == 10 * resources.solve_seconds(problem, path=100)


def test_limits_are_those_of_the_groups_around_too(tmp_path: Path, monkeypatch) -> None:
    """Memory limits of control groups of version 1 and 2 are read, those of parent groups included."""
    machine = resources.machine_memory()
    groups, own = tmp_path / "cgroup", tmp_path / "own"
    (groups / "outer/inner").mkdir(parents=True)
    (groups / "memory/job").mkdir(parents=True)
    monkeypatch.setattr(resources, "_CGROUPS", groups)
    monkeypatch.setattr(resources, "_PROCESS_CGROUPS", own)
    own.write_text("0::/outer/inner\n")
    (groups / "outer/inner/memory.max").write_text("max\n")
    assert resources.machine_memory() >= machine
    (groups / "outer/memory.max").write_text("12345678\n")
    assert resources.machine_memory() == 12345678
    own.write_text("5:cpu,memory:/job\n1:name=systemd:/x:y\n")
    assert resources.machine_memory() >= machine
    (groups / "memory/job/memory.limit_in_bytes").write_text("2345678\n")
    assert resources.machine_memory() == 2345678
    own.unlink()
    assert resources.machine_memory() >= machine


@pytest.mark.slow
@pytest.mark.parametrize(("name", "few", "many"), [("wall-1d", 1000, 4000), ("push-disc", 400, 1600)])
def test_memory_is_what_a_solve_takes(name: str, few: int, many: int) -> None:
    """Growth of the peak memory between two horizons is within a factor 2.5 of the prediction."""
    peaks = [
        float(
            subprocess.run(
                [sys.executable, "-c", PEAK, name, str(N)], capture_output=True, text=True, check=True
            ).stdout
        )
        for N in (few, many)
    ]
    told = resources.solve_memory(get(name, N=many)) - resources.solve_memory(get(name, N=few))
    assert told / 2.5 < peaks[1] - peaks[0] < 2.5 * told


def test_what_does_not_fit_is_refused_before_it_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "machine_memory", lambda: 1e5)
    with pytest.raises(InputError, match=r"wall-1d with N = 30 would take about .* GB of memory"):
        solve(get("wall-1d"), Barrier(mu=1e-2))


def test_a_year_is_the_most(monkeypatch: pytest.MonkeyPatch) -> None:
    resources.check_time("this", 0.99 * resources.YEAR)
    with pytest.raises(InputError, match="this would take about 2 years; take fewer"):
        resources.check_time("this", 2 * resources.YEAR)


def test_the_time_of_a_study_is_proportional_to_its_samples() -> None:
    objective = objective_spec("heaviside").objective()
    sampling = Sampling(("zobg",), 10**13, reference="none")
    study, longer = (SweepRun(objective, p) for p in (sampling, replace(sampling, samples=10**16)))
    assert (study.n_samples, longer.n_samples) == (10**13, 10**16)
    # Each prediction measures times, which vary on a busy machine.
    assert 100 < longer.predict_seconds() / study.predict_seconds() < 10_000
    assert SweepRun(objective, replace(sampling, samples=10**5)).predict_seconds() == 0
