"""Instances of the named problems with parameters drawn around their defaults."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic.fields import FieldInfo

from dynamics.settings import settings_of
from ocp.errors import InputError
from problems import spec
from problems.parameters import is_structural

PROBLEMS = (
    "wall-1d",
    "push-1d",
    "push-disc",
    "ball-bounce",
    "cart-walls",
    "box-slide",
    "ball-throw",
    "cart-transport",
    "hopper-1d",
    "planar-push",
)
FACTOR = 3.0
_SHIFT, _FROM_ZERO = 0.3, 0.1
"""Largest shift of a position as a share of its size, or in its unit if it is zero."""


@dataclass(frozen=True)
class Instance:
    """A problem with random parameters."""

    problem: str
    index: int
    params: dict[str, float]

    @property
    def key(self) -> str:
        """Name of the instance from a hash of its content."""
        text = json.dumps([self.problem, self.params], sort_keys=True)
        return f"{self.problem}/{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    @property
    def command(self) -> str:
        """Command that solves the instance."""
        given = " ".join(f"-p {name}={value!r}" for name, value in self.params.items())
        return f"ocp solve {self.problem} {given}"


def drawn(problem: str, count: int, seed: int, factor: float = FACTOR) -> Iterator[Instance]:
    """Draw ``count`` instances; those that the problem's validation rejects are drawn again."""
    symbols = {name: about for name, about in settings_of(spec(problem).Params).items() if not is_structural(about)}
    for index in range(count):
        rng = np.random.default_rng([seed, PROBLEMS.index(problem), index])
        while True:
            params = {name: _value(about.declaration, rng, factor) for name, about in symbols.items()}
            try:
                spec(problem).problem(params)
            except InputError:
                continue
            yield Instance(problem, index, params)
            break


def _value(field: FieldInfo, rng: np.random.Generator, factor: float) -> float:
    """Draw a value, log-uniform within a factor if it must be positive, else shifted by a share of itself."""
    default = float(field.default)
    positive = any(getattr(limit, "gt", getattr(limit, "ge", None)) == 0 for limit in field.metadata)
    if positive and default > 0:
        return default * factor ** rng.uniform(-1, 1)
    return default + rng.uniform(-1, 1) * (_SHIFT * abs(default) or _FROM_ZERO)
