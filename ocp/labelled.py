"""Arrays with named dimensions and units, which become a dataset of xarray at its first use."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


class Variable(NamedTuple):
    """An array with the names of its dimensions and its attributes, such as ``units``."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any]


class LabelledArrays:
    """Arrays by name, with coordinates and attributes, as in the xarray.Dataset that :attr:`dataset` makes of them.

    A solve and its store use the arrays alone: the import of xarray takes as long as a small solve.
    ``coords`` are the names of the variables that are coordinates.
    """

    def __init__(self, variables: Mapping[str, tuple[Any, ...]], coords: Mapping[str, Any] | None = None) -> None:
        """Take variables as xarray.Dataset does: (dimensions, values) or (dimensions, values, attributes).

        A coordinate may also be the list of its labels. An array without units gets the unit 1.
        """
        entries = {name: value if isinstance(value, tuple) else (name, value) for name, value in (coords or {}).items()}
        self.coords, self.attributes = frozenset(entries), dict[str, Any]()
        self.variables: dict[str, Variable] = {}
        for name, (dims, values, *attrs) in {**variables, **entries}.items():
            units = {} if name in self.coords else {"units": "1"}
            named_dims = (dims,) if isinstance(dims, str) else tuple(dims)
            self.variables[name] = Variable(named_dims, np.asarray(values), {**units, **(attrs[0] if attrs else {})})

    @classmethod
    def of(cls, dataset: xr.Dataset) -> LabelledArrays:
        """Return the arrays of a dataset, which remains the value of :attr:`dataset`."""
        arrays = cls({})
        arrays.variables = {
            str(name): Variable(tuple(map(str, v.dims)), v.values, v.attrs) for name, v in dataset.variables.items()
        }
        arrays.coords, arrays.attributes = frozenset(map(str, dataset.coords)), dataset.attrs
        arrays.dataset = dataset
        return arrays

    @cached_property
    def dataset(self) -> xr.Dataset:
        """The arrays as an xarray.Dataset, which shares their memory."""
        import xarray as xr

        coords = {name: self.variables[name] for name in self.variables if name in self.coords}
        arrays = {name: self.variables[name] for name in self.variables if name not in self.coords}
        return xr.Dataset(arrays, coords=coords, attrs=self.attributes)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.variables[name].values

    def __contains__(self, name: object) -> bool:
        return name in self.variables
