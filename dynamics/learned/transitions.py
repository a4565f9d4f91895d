"""Transitions of a system, measured or computed, and the samples from which models are learned."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.learned.stored import SCHEMA, TRANSITIONS, check_dataset
from dynamics.systems import Signal

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class DataOrigin:
    """Names and units of ``z`` and ``y``, and problem, parameters and hash of the data.

    z = (x, u), y = x_next: entries of z with the name of an entry of y are states, the other entries are
    inputs.
    """

    z: tuple[Signal, ...]
    y: tuple[Signal, ...]
    problem: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    data_hash: str = ""

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Entries of z that are inputs, not states."""
        states = {signal.name for signal in self.y}
        return tuple(signal for signal in self.z if signal.name not in states)

    def coordinates(self) -> dict[str, Any]:
        """Return the coordinates of a dataset: names in ``z``, ``state`` and ``input``, units in ``z_unit`` etc."""
        coordinates: dict[str, Any] = {}
        for dimension, entries in (("z", self.z), ("state", self.y), ("input", self.inputs)):
            # Without a type NumPy would make an array of numbers from an empty list.
            names = np.array([signal.name for signal in entries], dtype=str)
            units = np.array([signal.unit for signal in entries], dtype=str)
            coordinates |= {dimension: names, f"{dimension}_unit": (dimension, units)}
        return coordinates

    def attributes(self, kind: str) -> dict[str, Any]:
        """Return the attributes that files of transitions and models have in common."""
        return {
            "kind": kind,
            "schema": SCHEMA,
            "problem": self.problem,
            "parameters": json.dumps(dict(self.parameters), sort_keys=True),
            "data_hash": self.data_hash,
        }

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset, kind: str) -> DataOrigin:
        """Return the origin stored in a dataset's coordinates and attributes.

        Raises ``ValueError`` as :func:`~dynamics.learned.stored.check_dataset` does.
        """
        check_dataset(dataset, kind)
        z, y = (_signals(dataset, dimension) for dimension in ("z", "state"))
        attributes = dataset.attrs
        parameters = json.loads(attributes["parameters"])
        return cls(z, y, attributes["problem"], parameters, attributes["data_hash"])


def _signals(dataset: xr.Dataset, dimension: str) -> tuple[Signal, ...]:
    names, units = dataset[dimension].values, dataset[f"{dimension}_unit"].values
    return tuple(Signal(str(name), str(unit)) for name, unit in zip(names, units, strict=True))


@dataclass(frozen=True)
class Normalisation:
    """Normalisation ``(a - shift) / scale`` per coordinate, shift and scale (n,) in the coordinates' units.

    Noise of width sigma in normalised units is ``sigma scale`` in these units, such as metres or radians.
    """

    shift: np.ndarray
    scale: np.ndarray

    @classmethod
    def from_rows(cls, rows: np.ndarray, names: Sequence[str]) -> Normalisation:
        """Return the normalisation by mean and standard deviation of every column of ``rows`` (n_samples, n).

        Raises ``ValueError``, with the names of constant columns in its message.
        """
        scale = rows.std(axis=0)
        size = np.abs(rows).max(axis=0, initial=0.0)
        constant = [name for name, s, a in zip(names, scale, size, strict=True) if s <= 1e-12 * a]
        if constant:
            raise ValueError(
                f"data: {', '.join(constant)} never varies, so nothing can be learned from it; vary"
                " it in the data or leave it out"
            )
        return cls(rows.mean(axis=0), scale)

    def normalise(self, rows: np.ndarray) -> np.ndarray:
        """Convert rows (..., n) from the coordinates' units to normalised units."""
        return (rows - self.shift) / self.scale

    def denormalise(self, rows: np.ndarray) -> np.ndarray:
        """Convert rows (..., n) from normalised units to the coordinates' units."""
        return rows * self.scale + self.shift


@dataclass(frozen=True)
class Samples:
    """Training data of a model: ``z`` (n, nz) and ``y = f(z)`` (n, ny) in physical units, one row per sample.

    Raises ``ValueError`` for shapes that do not fit the names, and for rows that are not finite.
    """

    z: np.ndarray
    y: np.ndarray
    origin: DataOrigin

    def __post_init__(self) -> None:
        expected_shapes = (len(self.z), len(self.origin.z)), (len(self.z), len(self.origin.y))
        if (self.z.shape, self.y.shape) != expected_shapes:
            raise ValueError(
                f"data: z has shape {self.z.shape} and y {self.y.shape}, expected {expected_shapes[0]} and"
                f" {expected_shapes[1]} from their names"
            )
        next_names = [f"{signal.name}_next" for signal in self.origin.y]
        check_finite([self.z, self.y], [*(signal.name for signal in self.origin.z), *next_names])

    @property
    def scales(self) -> tuple[Normalisation, Normalisation]:
        """Normalisations of z and y over all rows; raises ``ValueError`` for a constant column."""
        named = (self.z, "{}", self.origin.z), (self.y, "the next {}", self.origin.y)
        z, y = (
            Normalisation.from_rows(rows, [form.format(signal.name) for signal in signals])
            for rows, form, signals in named
        )
        return z, y

    @property
    def hash(self) -> str:
        """SHA-256 of names, shapes and values."""
        digest = hashlib.sha256()
        for rows, signals in ((self.z, self.origin.z), (self.y, self.origin.y)):
            digest.update(repr([signal.name for signal in signals]).encode())
            digest.update(f"{rows.dtype.str}{rows.shape}".encode())
            digest.update(np.ascontiguousarray(rows).tobytes())
        return digest.hexdigest()


def check_finite(arrays: Sequence[np.ndarray], names: Sequence[str]) -> None:
    """Raise ``ValueError`` with the rows that have values that are not finite; ``names`` are the columns' names."""
    table = np.hstack(arrays)
    rows, columns = np.nonzero(~np.isfinite(table))
    if not len(rows):
        return
    bad_rows = np.unique(rows)
    listed_rows = ", ".join(map(str, bad_rows[:5])) + (", ..." if len(bad_rows) > 5 else "")
    first = f"{names[columns[0]]} is {table[rows[0], columns[0]]:g} in row {rows[0]}"
    raise ValueError(
        f"data: {len(bad_rows)} of {len(table)} rows hold values that are not finite ({listed_rows}, counted"
        f" from 0; {first}); leave them out or repair them"
    )


def split_rows(n: int, fraction: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Split n rows at random; return the sorted indices of the training rows and of the ``fraction`` held out.

    The same n, fraction and seed always give the same rows.
    """
    order = np.random.default_rng([seed, 1]).permutation(n)
    n_held_out = round(fraction * n)
    return np.sort(order[n_held_out:]), np.sort(order[:n_held_out])


MIN_ROWS_PER_COORDINATE = 10
"""Minimum number of rows of data per coordinate of z."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """Data of n steps: states ``x`` (n, nx), inputs ``u`` (n, nu) and next states ``x_next`` (n, nx).

    ``states`` and ``inputs`` are the names and units of the columns; ``normalisation`` applies to z = (x, u).
    ``provenance`` describes the origin of the data: ``problem``, ``parameters``, ``seed``, ``region`` and ``how``, if
    known.
    """

    x: np.ndarray
    u: np.ndarray
    x_next: np.ndarray
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    normalisation: Normalisation
    provenance: Mapping[str, Any]

    @classmethod
    def from_arrays(
        cls,
        x: np.ndarray,
        u: np.ndarray,
        x_next: np.ndarray,
        states: Sequence[Signal],
        inputs: Sequence[Signal],
        provenance: Mapping[str, Any] | None = None,
    ) -> Transitions:
        """Return transitions made from arrays, with the normalisation by mean and standard deviation.

        Raises ``ValueError`` for shapes that do not fit, values that are not finite (with the
        rows), a constant column, and fewer than ten rows for each entry of z.
        """
        states, inputs = tuple(states), tuple(inputs)
        x, u, x_next = (np.ascontiguousarray(a, dtype=float) for a in (x, u, x_next))
        n, nx, nu = len(x), len(states), len(inputs)
        for name, array, size in (("x", x, nx), ("u", u, nu), ("x_next", x_next, nx)):
            if array.shape != (n, size):
                raise ValueError(f"data: {name} has shape {array.shape}, expected {(n, size)}")
        names = [signal.name for signal in (*states, *inputs)]
        check_finite([x, u, x_next], [*names, *(f"{signal.name}_next" for signal in states)])
        if n < MIN_ROWS_PER_COORDINATE * len(names):
            raise ValueError(
                f"data: {n} rows are too few to learn from; {len(names)} coordinates"
                f" ({', '.join(names)}) need at least {MIN_ROWS_PER_COORDINATE * len(names)}"
            )
        normalisation = Normalisation.from_rows(np.hstack([x, u]), names)
        return cls(x, u, x_next, states, inputs, normalisation, dict(provenance or {}))

    def __len__(self) -> int:
        return len(self.x)

    @cached_property
    def z(self) -> np.ndarray:
        """States and inputs side by side, (n, nx + nu)."""
        return np.hstack([self.x, self.u])

    @property
    def names(self) -> list[str]:
        """Names of the entries of z, states before inputs."""
        return [signal.name for signal in (*self.states, *self.inputs)]

    @property
    def units(self) -> list[str]:
        """Units of the entries of z, states before inputs."""
        return [signal.unit for signal in (*self.states, *self.inputs)]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of names, units and values, which identifies the data."""
        columns = [[s.name, s.unit] for s in (*self.states, *self.inputs)]
        digest = hashlib.sha256(json.dumps([len(self.states), columns]).encode())
        for array in (self.x, self.u, self.x_next):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()

    def check_signals(self, states: Sequence[Signal], inputs: Sequence[Signal], owner: str) -> None:
        """Raise ``ValueError`` unless names and units equal those of ``states`` and ``inputs``, in order."""
        expected_signals = [[(s.name, s.unit) for s in group] for group in (states, inputs)]
        for role, data_signals, expected in zip(
            ("states", "inputs"), (self.states, self.inputs), expected_signals, strict=True
        ):
            if [(s.name, s.unit) for s in data_signals] != expected:
                raise ValueError(
                    f"data: the {role} are {list_signals(data_signals)}, and {owner} has"
                    f" {', '.join(f'{name} [{unit}]' for name, unit in expected)};"
                    " take data of that problem, or the problem of these data"
                )

    @property
    def origin(self) -> DataOrigin:
        """Description of the data's origin; models store it."""
        provenance = self.provenance
        problem, parameters = str(provenance.get("problem", "")), provenance.get("parameters", {})
        return DataOrigin((*self.states, *self.inputs), self.states, problem, parameters, self.hash)

    def samples(self) -> Samples:
        """Return z and the next states as training data of a model."""
        return Samples(self.z, self.x_next, self.origin)

    def dataset(self) -> xr.Dataset:
        """Return the transitions as labelled arrays: ``x``, ``u`` and ``x_next`` over sample and state or input.

        Coordinates, units and the scales of z have the same names as in a model's dataset; an attribute
        contains the provenance as JSON.
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
    def from_dataset(cls, dataset: xr.Dataset) -> Transitions:
        """Return the transitions that :meth:`dataset` stored; raise ``ValueError`` if the dataset has another form."""
        origin = DataOrigin.from_dataset(dataset, TRANSITIONS)
        names = ("x", "u", "x_next", "z_shift", "z_scale")
        x, u, x_next, shift, scale = (np.array(dataset[name].values) for name in names)
        provenance = json.loads(dataset.attrs["provenance"])
        transitions = cls.from_arrays(x, u, x_next, origin.y, origin.inputs, provenance)
        if transitions.hash != dataset.attrs["data_hash"]:
            raise ValueError("the values were changed: their hash differs")
        return replace(transitions, normalisation=Normalisation(shift, scale))


def list_signals(signals: Sequence[Signal]) -> str:
    """Return names with units as text, ``ox [m], theta [rad]``."""
    return ", ".join(f"{signal.name} [{signal.unit}]" for signal in signals)
