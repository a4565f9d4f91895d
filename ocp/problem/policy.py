"""Policies, which determine the inputs along a trajectory: open loop and affine feedback."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from dynamics.settings import Configured, setting


@dataclass(frozen=True)
class OpenLoop:
    """Open loop: a single sequence of inputs ``u_t``, t < N, used in every scenario."""

    name: ClassVar[str] = "open-loop"
    summary: ClassVar[str] = "one input sequence, the same in every scenario"


@dataclass(frozen=True)
class Feedback(Configured):
    """Affine feedback ``u_t = K_t x_t + k_t`` shared by all scenarios (noising, eq. 14).

    K_t is (nu, nx), k_t (nu,). The guess is K = 0 and k = the guessed input (not k = 0, which would command the
    actuator to the origin and into the object). ``penalty`` adds ``penalty * sum_t |K_t|²`` characteristic costs,
    without which gains are not unique along scenarios that nearly coincide; ``bound`` limits the absolute value of
    each gain; ``stationary`` uses the same (K, k) for all steps.

    Raises :class:`~ocp.errors.InputError` for a negative or non-finite penalty or bound.
    """

    penalty: float = setting(1e-4, "times sum |K|², in characteristic costs, added to the cost", least=0)
    bound: float = setting(math.inf, "largest size of a gain", above=0)
    stationary: bool = setting(False, "one K and k for all steps")
    name: ClassVar[str] = "feedback"
    summary: ClassVar[str] = "u = K x + k with gains shared by all scenarios"


Policy = OpenLoop | Feedback
POLICIES: dict[str, type[Policy]] = {policy.name: policy for policy in (OpenLoop, Feedback)}
"""Mapping from the name of a policy to its class."""
