"""Policies that ``ocp train`` learns with default settings run under the exact law for 5 s."""

from __future__ import annotations

from pathlib import Path

import pytest

from ocp import store
from ocp.learning.experiment import EXACT
from ocp.learning.training import evaluate
from problems.tasks.training import rebuilt
from reports.cli.app import main

SPEEDS = {"half-cheetah": 1.5, "hopper": 1.0}
"""Mapping from task to the mean forward speed [m/s] that a policy must reach."""


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SPEEDS))
def test_machines_learn_to_run(name: str, tmp_path: Path) -> None:
    """Policies are evaluated on 100 new episodes, and do not fall in most of them."""
    assert main(["train", name, "--out", str(tmp_path), "--quiet"]) == 0
    (entry,) = store.list_runs(tmp_path)
    run = store.load(entry.path)
    experiment, policy = rebuilt(run)
    h = dict(zip(experiment.task.parameters.names, experiment.physics, strict=True))["h"]
    assert experiment.task.horizon * h == pytest.approx(5.0)
    found = evaluate(experiment, policy, EXACT, 100, seed=7)
    assert found.measures["speed"].mean() >= SPEEDS[name]
    assert (found.lengths == experiment.task.horizon).mean() >= 0.95
    assert run.data["wall_s"].values[-1] < 15 * 60
