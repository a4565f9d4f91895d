"""Regions from which transitions are drawn: ranges of states and inputs, and a tube around a line to the goal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from dynamics.systems import ContactSystem

Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Region:
    """Ranges of states and inputs by name, in the system's units, and a tube of states for half of the data.

    ``around`` maps an input whose range is relative to a state to that state, such as a commanded position to
    the actuated one: ``{"ux": "ax"}``. The tube is the straight line from ``start`` to ``goal`` (nx,) with
    Gaussian noise of width ``spread`` (nx,), not limited to the ranges.
    """

    states: Ranges
    inputs: Ranges
    start: Sequence[float]
    goal: Sequence[float]
    spread: Sequence[float]
    around: Mapping[str, str] = field(default_factory=dict)

    def check(self, system: ContactSystem) -> None:
        """Raise ``ValueError`` if names or sizes differ from ``system``, or a number is not valid."""
        states, inputs = ([s.name for s in signals] for signals in (system.states, system.inputs))
        for role, ranges, names in (("state", self.states, states), ("input", self.inputs, inputs)):
            if set(ranges) != set(names):
                raise ValueError(
                    f"the region has a range for {role}s {', '.join(ranges) or 'none'}, and"
                    f" {system.name} has {', '.join(names) or 'none'}; give one for each"
                )
            for name, (low, high) in ranges.items():
                if not (np.isfinite(high - low) and low < high):
                    raise ValueError(
                        f"the region's range of {role} {name} must be finite and rise, got [{low:g}, {high:g}]"
                    )
        unknown = [f"{u}: {x}" for u, x in self.around.items() if u not in inputs or x not in states]
        if unknown:
            raise ValueError(
                f"the region measures {unknown[0]}; expected an input of {', '.join(inputs)} from"
                f" a state of {', '.join(states)}"
            )
        for role in ("start", "goal", "spread"):
            value = np.asarray(getattr(self, role), dtype=float)
            if value.shape != (system.nx,) or not np.all(np.isfinite(value)):
                raise ValueError(f"the region's {role} must be {system.nx} finite numbers")
        if np.min(self.spread, initial=0) < 0:
            raise ValueError(f"the region's spread must not be negative, got {self.spread}")

    def box_states(self, rng: np.random.Generator, n: int, names: Sequence[str]) -> np.ndarray:
        """Return random states (n, nx), uniform in their ranges."""
        return _uniform(rng, n, self.states, names)

    def tube_states(self, rng: np.random.Generator, n: int, names: Sequence[str]) -> np.ndarray:
        """Return random states (n, nx), uniform along the line from start to goal, plus Gaussian noise."""
        start, goal, spread = (np.asarray(v, float) for v in (self.start, self.goal, self.spread))
        line_share = rng.uniform(size=(n, 1))
        return start + line_share * (goal - start) + spread * rng.standard_normal((n, len(names)))

    def draw_inputs(
        self, rng: np.random.Generator, x: np.ndarray, states: Sequence[str], inputs: Sequence[str]
    ) -> np.ndarray:
        """Return random inputs (n, nu), uniform in their ranges, for the states ``x`` (n, nx)."""
        u = _uniform(rng, len(x), self.inputs, inputs)
        for name, state in self.around.items():
            u[:, inputs.index(name)] += x[:, states.index(state)]
        return u

    def described(self) -> dict[str, Any]:
        """Return the region as a dict of plain values, for the provenance of the data."""
        return asdict(self)


def _uniform(rng: np.random.Generator, n: int, ranges: Ranges, names: Sequence[str]) -> np.ndarray:
    low, high = np.array([ranges[name] for name in names]).reshape(-1, 2).T
    return rng.uniform(low, high, (n, len(names)))
