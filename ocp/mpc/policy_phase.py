"""Feedback phase without plans that evaluates a function of the state, or gains."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ocp.mpc.phase import Answer, Phase, Sample, numbers
from ocp.mpc.stages import Plan
from ocp.problem.rollout import Gains

Law = Callable[[np.ndarray, int], np.ndarray]
"""Feedback ``u = law(x, k)`` of the state (nx,) at sample k, counted from 0."""


class FixedPolicy(Phase):
    """Phase that evaluates the feedback ``u = law(x, k)``, or gains, and clips the input to its bounds."""

    plans = False

    def __init__(self, law: Law | Gains, nu: int) -> None:
        self.law: Law = (lambda x, k: law.input(k, x)) if isinstance(law, Gains) else law
        self.nu, self.count = nu, 0

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Do nothing; there is no plan."""

    def feedback(self, sample: Sample) -> Answer:
        """Evaluate the feedback law; raise :class:`~ocp.errors.InputError` unless it returns nu numbers."""
        u = np.ravel(self.law(sample.x, self.count))
        u = numbers("the policy's input", u, (self.nu,))
        self.count += 1
        if not np.isfinite(u).all():
            note = "the policy's input is not finite; the previous input is used"
            return Answer(np.clip(sample.u_before, *sample.bounds), None, "kept", note)
        return Answer(np.clip(u, *sample.bounds), None)
