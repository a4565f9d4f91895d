"""Transitions and models on disk: one netCDF file each, written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.learned import files
from dynamics.learned.transitions import Transitions
from ocp.errors import InputError
from ocp.store import atomic

if TYPE_CHECKING:
    import xarray as xr


def save(dataset: xr.Dataset, path: Path) -> None:
    """Write what ``.dataset()`` of transitions or a model gave, and whatever was merged to it.

    Raises :class:`~ocp.errors.InputError` where the file cannot be written.
    """
    whole = dataset.assign_attrs({files.CHECKSUM: files.checksum(dataset)})
    with atomic.replacing(path, "the file") as draft:
        whole.to_netcdf(draft, engine="netcdf4")


def load(path: Path) -> xr.Dataset:
    """What a file of transitions or of a model holds.

    Raises :class:`~ocp.errors.InputError` with a sentence where it is not whole, or something else.
    """
    try:
        return files.read(path)
    except ValueError as error:
        raise InputError(str(error)) from error


def load_transitions(path: Path) -> Transitions:
    """Transitions from their file; raises as :func:`load` does."""
    try:
        return files.read_transitions(path)
    except ValueError as error:
        raise InputError(str(error)) from error


def load_model(path: Path) -> Any:
    """A model from its file; raises as :func:`load` does."""
    try:
        return files.read_model(path)
    except ValueError as error:
        raise InputError(str(error)) from error
