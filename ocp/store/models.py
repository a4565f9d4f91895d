"""Transitions and models on disk: one netCDF file each, written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.learned import files
from dynamics.learned.transitions import Transitions
from ocp.errors import input_errors
from ocp.store import atomic

if TYPE_CHECKING:
    import xarray as xr


def save(dataset: xr.Dataset, path: Path) -> None:
    """Write what ``.dataset()`` of transitions or a model gave, and whatever was merged to it.

    Raises :class:`~ocp.errors.InputError` where the file cannot be written.
    """
    whole = dataset.assign_attrs({files.CHECKSUM: files.checksum(dataset)})
    atomic.write(path, atomic.netcdf(whole, f"the file {path}"), "the file")


def load_any(path: Path) -> Transitions | xr.Dataset:
    """Transitions, or all that the file of a model holds; raises as :func:`load_model` does."""
    with input_errors():
        dataset = files.read(path)
        if dataset.attrs["kind"] == files.TRANSITIONS:
            return files.transitions_of(dataset, path)
        files.model_of(dataset, path)
    return dataset


def load_transitions(path: Path) -> Transitions:
    """Transitions from their file; raises as :func:`load_model` does."""
    with input_errors():
        return files.transitions_of(files.read(path), path)


def load_model(path: Path) -> Any:
    """A model from its file.

    Raises :class:`~ocp.errors.InputError` with a sentence where it is not whole, or something else.
    """
    with input_errors():
        return files.read_model(path)
