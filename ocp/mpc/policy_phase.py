"""Feedback that plans nothing: a function of the state, gains of a plan, or a regulator's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ocp.mpc.phase import Answer, Sample, numbers
from ocp.mpc.stages import Plan

Law = Callable[[np.ndarray, int], np.ndarray]
"""``u = law(x, k)`` at the sample k, counted from 0."""


class FixedPolicy:
    """``u = law(x, k)``, clipped to the bounds. The horizon does not move."""

    def __init__(self, law: Law, nu: int) -> None:
        self.law, self.nu, self.count = law, nu, 0

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Nothing to prepare."""

    def feedback(self, sample: Sample) -> Answer:
        """Evaluate the law; raises :class:`~ocp.errors.InputError` for no nu numbers."""
        u = np.ravel(self.law(sample.x, self.count))
        u = numbers("the policy's input", u, (self.nu,))
        self.count += 1
        if not np.isfinite(u).all():
            return Answer(
                np.clip(sample.u_before, *sample.bounds),
                None,
                "kept",
                "the policy's input is not finite; the input before goes on",
            )
        return Answer(np.clip(u, *sample.bounds), None)
