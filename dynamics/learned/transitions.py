"""Measured or computed steps of a system: where it was, what was done, where it came to be."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.learned.samples import Normalisation, Origin, Samples, check_finite
from dynamics.learned.stored import TRANSITIONS
from dynamics.systems import Signal

if TYPE_CHECKING:
    import xarray as xr

LEAST = 10
"""Rows for every coordinate of z below which nothing is learned."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """n steps: states ``x`` (n, nx), inputs ``u`` (n, nu) and next states ``x_next`` (n, nx).

    ``states`` and ``inputs`` name the columns and their units, in which all values are;
    ``normalisation`` is of z = (x, u). ``provenance`` states where the data come from: ``problem``,
    ``parameters``, ``seed``, ``region``, ``how``, as far as they are known.
    """

    x: np.ndarray
    u: np.ndarray
    x_next: np.ndarray
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    normalisation: Normalisation
    provenance: Mapping[str, Any]

    @classmethod
    def checked(
        cls,
        x: np.ndarray,
        u: np.ndarray,
        x_next: np.ndarray,
        states: Sequence[Signal],
        inputs: Sequence[Signal],
        provenance: Mapping[str, Any] | None = None,
    ) -> Transitions:
        """Transitions from arrays, normalised by mean and standard deviation of every column.

        Raises ``ValueError`` for shapes that do not fit, values that are not finite (with the
        rows), a column that never varies, and fewer than ten rows for each entry of z.
        """
        states, inputs = tuple(states), tuple(inputs)
        x, u, x_next = (np.ascontiguousarray(a, dtype=float) for a in (x, u, x_next))
        n, nx, nu = len(x), len(states), len(inputs)
        for what, array, size in (("x", x, nx), ("u", u, nu), ("x_next", x_next, nx)):
            if array.shape != (n, size):
                raise ValueError(f"data: {what} has shape {array.shape}, expected {(n, size)}")
        names = [signal.name for signal in (*states, *inputs)]
        check_finite([x, u, x_next], [*names, *(f"{signal.name}_next" for signal in states)])
        if n < LEAST * len(names):
            raise ValueError(
                f"data: {n} rows are too few to learn from; {len(names)} coordinates"
                f" ({', '.join(names)}) need at least {LEAST * len(names)}"
            )
        normalisation = Normalisation.of(np.hstack([x, u]), names)
        return cls(x, u, x_next, states, inputs, normalisation, dict(provenance or {}))

    def __len__(self) -> int:
        return len(self.x)

    @cached_property
    def z(self) -> np.ndarray:
        """States and inputs side by side, (n, nx + nu)."""
        return np.hstack([self.x, self.u])

    @property
    def names(self) -> list[str]:
        """Names of the entries of z."""
        return [signal.name for signal in (*self.states, *self.inputs)]

    @property
    def units(self) -> list[str]:
        """Units of the entries of z."""
        return [signal.unit for signal in (*self.states, *self.inputs)]

    @cached_property
    def hash(self) -> str:
        """SHA-256 over names, units and values: the same data have the same hash."""
        columns = [[s.name, s.unit] for s in (*self.states, *self.inputs)]
        digest = hashlib.sha256(json.dumps([len(self.states), columns]).encode())
        for array in (self.x, self.u, self.x_next):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()

    def check_signals(self, states: Sequence[Signal], inputs: Sequence[Signal], owner: str) -> None:
        """Raise ``ValueError`` unless names and units are those of ``owner``, in its order."""
        wanted = [[(s.name, s.unit) for s in part] for part in (states, inputs)]
        for what, own, expected in zip(
            ("states", "inputs"), (self.states, self.inputs), wanted, strict=True
        ):
            if [(s.name, s.unit) for s in own] != expected:
                raise ValueError(
                    f"data: the {what} are {listed(own)}, and {owner} has"
                    f" {', '.join(f'{name} [{unit}]' for name, unit in expected)};"
                    " take data of that problem, or the problem of these data"
                )

    @property
    def origin(self) -> Origin:
        """The origin that a model of these data stores."""
        known = self.provenance
        problem, parameters = str(known.get("problem", "")), known.get("parameters", {})
        return Origin((*self.states, *self.inputs), self.states, problem, parameters, self.hash)

    def samples(self) -> Samples:
        """``z`` and the next states as a map is learned from them."""
        return Samples(self.z, self.x_next, self.origin)

    def dataset(self) -> xr.Dataset:
        """As labelled arrays: ``x``, ``u`` and ``x_next`` over sample and state or input.

        Coordinates, units and the scales of z are called as in a model's; provenance is JSON in
        the attributes.
        """
        import xarray as xr

        data = {
            "x": (("sample", "state"), self.x),
            "u": (("sample", "input"), self.u),
            "x_next": (("sample", "state"), self.x_next),
            "z_shift": ("z", self.normalisation.shift),
            "z_scale": ("z", self.normalisation.scale),
        }
        origin = self.origin
        attributes = {
            **origin.attributes(TRANSITIONS),
            "provenance": json.dumps(dict(self.provenance), sort_keys=True),
        }
        return xr.Dataset(data, origin.coordinates(), attributes)

    @classmethod
    def of(cls, dataset: xr.Dataset) -> Transitions:
        """Read :meth:`dataset` back; raises ``ValueError`` where it has no such form."""
        origin = Origin.of(dataset, TRANSITIONS)
        names = ("x", "u", "x_next", "z_shift", "z_scale")
        x, u, x_next, shift, scale = (np.array(dataset[name].values) for name in names)
        provenance = json.loads(dataset.attrs["provenance"])
        found = cls.checked(x, u, x_next, origin.y, origin.inputs, provenance)
        if found.hash != dataset.attrs["data_hash"]:
            raise ValueError("the values were changed: their hash differs")
        return replace(found, normalisation=Normalisation(shift, scale))


def listed(signals: Sequence[Signal]) -> str:
    """Names with units, ``ox [m], theta [rad]``."""
    return ", ".join(f"{signal.name} [{signal.unit}]" for signal in signals)
