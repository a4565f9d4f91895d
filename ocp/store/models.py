"""Files of transitions and of learned models, each a netCDF file that is written atomically."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.learned import files
from dynamics.learned.transitions import Transitions
from ocp.errors import input_errors
from ocp.labelled import LabelledArrays
from ocp.store import atomic

if TYPE_CHECKING:
    import xarray as xr


def save(dataset: xr.Dataset, path: Path) -> None:
    """Write ``dataset``, made by ``.dataset()`` of transitions or of a model, to a file with a checksum.

    The dataset may have additional variables. Raises :class:`~ocp.errors.InputError` if the file cannot be written.
    """
    sealed_dataset = dataset.assign_attrs({files.CHECKSUM_KEY: files.checksum(dataset)})
    atomic.write_file(path, atomic.netcdf_bytes(LabelledArrays.of(sealed_dataset), f"the file {path}"), "the file")


def load_any(path: Path) -> Transitions | xr.Dataset:
    """Read transitions, or the dataset of a model, from a file; raises the errors of :func:`load_model`."""
    with input_errors():
        dataset = files.read_dataset(path)
        if dataset.attrs["kind"] == files.TRANSITIONS:
            return files.transitions_of(dataset, path)
        files.model_of(dataset, path)
    return dataset


def load_transitions(path: Path) -> Transitions:
    """Read transitions from a file; raises the errors of :func:`load_model`."""
    with input_errors():
        return files.transitions_of(files.read_dataset(path), path)


def load_model(path: Path) -> Any:
    """Read a learned model from a file.

    Raises :class:`~ocp.errors.InputError` if the file is incomplete or contains no model.
    """
    with input_errors():
        return files.read_model(path)
