"""Rollouts of candidates agree with their definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ocp.mpc.controller import Controller
from ocp.mpc.rollouts import STEP_SHARES
from problems import get


def test_candidates_without_change_and_with_feedback_roll_out_the_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plan is a rollout of its own inputs from its own start, and feedback then adds nothing."""
    # Without a compiler: a compiled sample takes seconds to build.
    monkeypatch.setenv("PATH", str(tmp_path))
    controller = Controller(get("soft-walls", N=5))
    plan, sizes, rng = controller.current_plan, controller.problem.scales, np.random.default_rng(0)
    _, p, limits = controller._horizon
    gains = 0.1 * (sizes.u[:, None] / sizes.x) * rng.standard_normal((len(plan.u), len(sizes.u), len(sizes.x)))
    K, k = controller.rollouts.steer(gains, plan.x, plan.u, 0 * plan.x, 0 * plan.u, STEP_SHARES[:2])
    rolled = controller.rollouts.roll_out(plan.x[0], K, k, controller.u_before, (limits[2], limits[3]), p)
    assert np.abs((rolled.states - plan.x) / sizes.x).max() < 1e-6
