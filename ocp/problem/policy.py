"""Policies: how inputs come about along a trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from ocp.errors import InputError


@dataclass(frozen=True)
class OpenLoop:
    """One input sequence ``u_t``, t < N, the same in every scenario."""

    name: ClassVar[str] = "open-loop"
    summary: ClassVar[str] = "one input sequence, the same in every scenario"


@dataclass(frozen=True)
class Feedback:
    """Affine feedback ``u_t = K_t x_t + k_t`` shared by all scenarios (noising, eq. 14).

    K_t (nu, nx), k_t (nu,). It starts at K = 0 and k = the guessed input (never k = 0, which would
    command the actuator to the origin, into the object). ``penalty`` adds
    ``penalty * sum_t |K_t|²`` characteristic costs, without which gains along scenarios that nearly
    coincide are redundant; ``bound`` limits each gain's size; ``stationary`` uses one (K, k) for
    all steps.

    Raises :class:`~ocp.errors.InputError` for a negative or non-finite penalty or bound.
    """

    penalty: Annotated[float, "times sum |K|², in characteristic costs, added to the cost"] = 1e-4
    bound: Annotated[float, "largest size of a gain"] = math.inf
    stationary: Annotated[bool, "one K and k for all steps"] = False
    name: ClassVar[str] = "feedback"
    summary: ClassVar[str] = "u = K x + k with gains shared by all scenarios"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.penalty) and self.penalty >= 0):
            raise InputError(f"feedback: penalty must be 0 or more and finite, got {self.penalty}")
        if not self.bound > 0:
            raise InputError(f"feedback: bound must be positive, got {self.bound}")


Policy = OpenLoop | Feedback
POLICIES: dict[str, type[Policy]] = {policy.name: policy for policy in (OpenLoop, Feedback)}
