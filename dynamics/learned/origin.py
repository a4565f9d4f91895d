"""Where a model comes from: what its numbers are called, and the data that it saw."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.systems.parameters import Signal

if TYPE_CHECKING:
    import xarray as xr

SCHEMA = 1


@dataclass(frozen=True)
class Origin:
    """Names and units of ``z`` and ``y``, and whose data they were.

    Entries of z that y has too are states, the others inputs: z = (x, u), y = x_next.
    """

    z: tuple[Signal, ...]
    y: tuple[Signal, ...]
    problem: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    data_hash: str = ""

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Entries of z that are no states."""
        states = {signal.name for signal in self.y}
        return tuple(signal for signal in self.z if signal.name not in states)

    def coordinates(self) -> dict[str, Any]:
        """``z``, ``state`` and ``input`` of a dataset: names, and units as ``state_unit`` etc."""
        found: dict[str, Any] = {}
        for dimension, entries in (("z", self.z), ("state", self.y), ("input", self.inputs)):
            # A type that is said, for of no input at all NumPy would make numbers.
            names = np.array([signal.name for signal in entries], dtype=str)
            units = np.array([signal.unit for signal in entries], dtype=str)
            found |= {dimension: names, f"{dimension}_unit": (dimension, units)}
        return found

    def attributes(self, kind: str, sigma: float, seed: int) -> dict[str, Any]:
        """What all models say about themselves."""
        return {
            "kind": kind,
            "schema": SCHEMA,
            "sigma": float(sigma),
            "problem": self.problem,
            "parameters": json.dumps(dict(self.parameters), sort_keys=True),
            "data_hash": self.data_hash,
            "seed": int(seed),
        }

    @classmethod
    def of(cls, dataset: xr.Dataset, kind: str) -> Origin:
        """Back from a dataset with these coordinates and attributes.

        Raises ``ValueError`` for one that is no model of this kind, or of a newer schema.
        """
        found = dataset.attrs.get("kind")
        if found != kind:
            raise ValueError(f"model: expected one of kind {kind!r}, found {found!r}")
        if int(dataset.attrs["schema"]) != SCHEMA:
            raise ValueError(
                f"model: its schema is {dataset.attrs['schema']}, this version reads {SCHEMA};"
                " learn it again"
            )
        z, y = (_signals(dataset, dimension) for dimension in ("z", "state"))
        attributes = dataset.attrs
        parameters = json.loads(attributes["parameters"])
        return cls(z, y, attributes["problem"], parameters, attributes["data_hash"])


def _signals(dataset: xr.Dataset, dimension: str) -> tuple[Signal, ...]:
    names, units = dataset[dimension].values, dataset[f"{dimension}_unit"].values
    return tuple(Signal(str(name), str(unit)) for name, unit in zip(names, units, strict=True))
