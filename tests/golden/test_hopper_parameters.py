"""The hopper's eleven physical parameters are identified from 2,000 exact transitions of random policies."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp.learning.explorer import Explorer, random_transitions
from ocp.learning.identify import OneStepLoss, bootstrap_intervals, identify
from ocp.search.random_search import RandomSearch
from problems.tasks.registry import get

LINKS = ("torso", "thigh", "leg", "foot")
PSI = ["friction", "spring", "damping"]
PSI += [f"{kind}_{link}" for kind in ("mass", "inertia") for link in LINKS]


@pytest.mark.costly
def test_psi_is_recovered_within_five_percent_from_half_and_twice_the_truth():
    task = get("hopper")
    seen, touched = random_transitions(Explorer(task), 2000, seed=1)
    assert 0.2 < touched.mean() < 0.8
    loss = OneStepLoss(Exact().close(task.system), PSI, scale=OneStepLoss.increments(seen))
    truth = loss.start()
    start = truth + np.random.default_rng(0).uniform(np.log(0.5), np.log(2), truth.size)
    assert np.abs(start - truth).max() > 0.5
    found = identify(loss, seen, start, RandomSearch(narrow=5e-3), rows=64)
    assert found.values == pytest.approx(np.exp(truth), rel=0.05)
    around = bootstrap_intervals(loss, np.log(found.values), seen[:1000])
    inside = (around.low <= 1.0001 * np.exp(truth)) & (around.high >= 0.9999 * np.exp(truth))
    assert inside.all()


@pytest.mark.costly
def test_before_the_landing_all_but_friction_are_determined():
    task = get("hopper")
    seen, touched = random_transitions(Explorer(task), 2000, seed=1)
    flying = seen[~touched & (seen.x[:, 1] > 1.3)]
    loss = OneStepLoss(Exact().close(task.system), PSI, scale=OneStepLoss.increments(seen))
    found = bootstrap_intervals(loss, loss.start(), flying[:300])
    unknown = [name for name, high in zip(PSI, found.high, strict=True) if np.isinf(high)]
    assert unknown == ["friction"]
    weakest = np.linalg.eigh(found.information).eigenvectors[:, 0]
    assert np.abs(weakest) == pytest.approx(np.eye(len(PSI))[0], abs=1e-6)
