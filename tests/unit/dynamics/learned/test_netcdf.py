"""Files that the netCDF library cannot read, or reads forever."""

from __future__ import annotations

import lzma
from base64 import b85decode
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from dynamics.learned.netcdf import check_readable

ENDLESS = Path(__file__).parents[3] / "data" / "endless.nc.xz.b85"
"""File of a run's arrays with one bit changed in HDF5's tables, which makes the reader loop forever."""


def content() -> bytes:
    data = xr.Dataset({"x": ("i", np.arange(200.0)), "name": ("k", ["a", "bc"])})
    return bytes(data.to_netcdf(engine="netcdf4"))


def test_what_was_written_is_readable() -> None:
    check_readable(content())


@pytest.mark.parametrize("damage", ["empty", "text", "cut", "zeros"])
def test_damaged_files_are_named(damage: str) -> None:
    whole = content()
    damaged = {
        "empty": b"",
        "text": b"x" * 500,
        "cut": whole[:1000],
        "zeros": whole[:40] + bytes(200) + whole[240:],
    }[damage]
    with pytest.raises(ValueError, match=r"\S"):
        check_readable(damaged)


@pytest.mark.costly
def test_a_file_that_never_ends_is_given_up() -> None:
    with pytest.raises(ValueError, match="reading it takes too long"):
        check_readable(lzma.decompress(b85decode(ENDLESS.read_bytes().strip())))
