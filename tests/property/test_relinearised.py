"""The second way to a step with curved gaps, where the path of the first leads nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.contact import Relinearised
from ocp import Problem
from ocp.rollout import roll_on
from problems import get


def values_of(problem: Problem) -> dict[str, float]:
    return {parameter.name: parameter.value for parameter in problem.parameters}


def wild_inputs(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    p = problem.parameters.values
    before, low, high = (np.array(v).ravel() for v in problem.limits(p)[1:4])
    size = problem.N, problem.system.nu
    if np.isfinite(low).all():
        return rng.uniform(low, high, size=size)[None]
    return before + np.cumsum(rng.normal(scale=0.2, size=size), axis=0)[None]


@pytest.mark.parametrize("name", ["push-disc", "planar-push"])
def test_wild_inputs_are_refereed_to_their_end(name: str) -> None:
    """Also where the pusher is commanded past the object, so that a contact turns its back."""
    problem, rng = get(name), np.random.default_rng(0)
    step, lost_before = problem.referee_step, 0
    p = step.p.values
    for _ in range(40):
        inputs = wild_inputs(problem, rng)
        rolled, unsolved = roll_on(problem, inputs, values_of(problem), step)
        assert unsolved is None
        for k in range(problem.N):
            x, u = rolled.x[0, k], rolled.u[0, k]
            lost_before += np.array(step.solve(x, u, p)[3]).max() > 1e-7
            residual, gap, _ = (
                np.array(part) for part in
                step.relation(x, u, rolled.x[0, k + 1], rolled.lam[0, k], p)
            )  # fmt: skip
            lam = rolled.lam[0, k][:, None]
            scale = 1 + np.abs(lam).max()
            assert np.abs(residual).max() < 1e-8 * scale
            assert min(lam.min(), gap.min()) > -1e-7 * scale
            assert np.abs(lam * gap).max() < 1e-7 * scale
    assert lost_before > 0, "some steps were lost on the path"


def test_both_ways_lead_to_the_same_end() -> None:
    problem, rng = get("planar-push"), np.random.default_rng(1)
    step = problem.referee_step
    other, p = Relinearised(step), step.p.values
    compared = 0
    for _ in range(6):
        x = np.array([0.0, 0.5, rng.normal(scale=0.3), rng.uniform(-0.2, 0.2), -0.25])
        u = x[3:] + rng.uniform(-0.2, 0.4, size=2)
        by_path, _, _, error = (np.array(part).ravel() for part in step.solve(x, u, p))
        again, _, _, worst = other.solve(x, u, p)
        assert worst.max() < 1e-7
        if error.max() < 1e-9:
            np.testing.assert_allclose(again, by_path, atol=1e-6)
            compared += 1
    assert compared >= 5
