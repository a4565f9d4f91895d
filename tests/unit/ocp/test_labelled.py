"""Labelled arrays have the dataset of xarray, and their files are those from which xarray reads that dataset."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from ocp.labelled import LabelledArrays
from ocp.store.atomic import netcdf_bytes
from ocp.store.json_values import content_hash

VARIABLES = {
    "x": (("node", "state"), np.array([[1.5, np.nan], [np.inf, -0.0]]), {"units": "m"}),
    "count": ("node", np.array([2, -(2**40)])),
    "is_active": ("node", [True, False]),
    "stage_label": ("stage", ["contact.mu", "Größe", ""]),
    "state_unit": ("state", np.array(["m", "s"], dtype=object)),
    "empty": (("row", "state"), np.zeros((0, 2))),
    "total": ((), 3.25, {"units": "J", "widths": [0.5, 1.0], "names": ["a", "ü"], "samples": 3}),
}
COORDS = {"state": ["q", "v"], "time": ("node", np.array([0.0, 0.1]), {"units": "s"})}


def expected() -> xr.Dataset:
    dataset = xr.Dataset(VARIABLES, coords=COORDS)
    for variable in dataset.data_vars.values():
        variable.attrs.setdefault("units", "1")
    return dataset


def test_the_dataset_is_the_one_that_xarray_makes() -> None:
    arrays = LabelledArrays(VARIABLES, COORDS)
    xr.testing.assert_identical(arrays.dataset, expected())
    assert "x" in arrays and "node" not in arrays
    assert np.shares_memory(arrays["x"], arrays.dataset["x"].values)


@pytest.mark.parametrize("direct", [True, False])
def test_a_written_file_has_the_same_dataset_as_one_that_xarray_writes(direct: bool) -> None:
    dataset = expected().assign_attrs(seed=4, study="P6", widths=[0.5, 1.0])
    arrays = LabelledArrays.of(dataset)
    if direct:
        arrays = LabelledArrays(VARIABLES, COORDS)
        arrays.attributes.update(dataset.attrs)
    read, by_xarray = (
        xr.load_dataset(bytes(content), engine="netcdf4")
        for content in (netcdf_bytes(arrays, "the arrays"), dataset.to_netcdf(engine="netcdf4"))
    )
    xr.testing.assert_identical(read, by_xarray)
    xr.testing.assert_identical(read, dataset)
    assert read["is_active"].dtype == bool and read["count"].dtype == np.int64


def test_the_hash_is_of_values_dimensions_and_attributes() -> None:
    first = content_hash(LabelledArrays(VARIABLES, COORDS), {})
    assert content_hash(LabelledArrays.of(expected()), {}) == first
    changes = {
        "x": (("node", "state"), np.ones((2, 2)), {"units": "m"}),
        "count": ("state", np.array([2, -(2**40)])),
        "total": ((), 3.25, {"units": "N"}),
    }
    for name, variable in changes.items():
        assert content_hash(LabelledArrays({**VARIABLES, name: variable}, COORDS), {}) != first
