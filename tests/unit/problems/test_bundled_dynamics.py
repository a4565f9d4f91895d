"""The mean of exact steps is a contact law with the interface of a learned one."""

from __future__ import annotations

import numpy as np

from dynamics.contact.learned_step import LearnedStep
from problems.registry import get
from problems.studies.start_without_contact.dynamics import Bundle, Bundled


def test_a_bundle_closes_a_system_by_its_own_map() -> None:
    problem = get("push-1d")
    width = np.full(problem.system.nx + problem.system.nu, 0.01)
    step = Bundled(Bundle(problem.exact_step, width, samples=4, seed=0)).close(problem.system)
    assert isinstance(step, LearnedStep) and step.mu.numel() == step.lam.numel() == 0
