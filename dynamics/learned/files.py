"""Reading transitions and models from their files: arrays and attributes in netCDF, never code."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.learned.stored import EWDA, KINDS, TRANSITIONS, plain
from dynamics.learned.transitions import Transitions

if TYPE_CHECKING:
    import xarray as xr

CHECKSUM = "checksum"
_HDF = b"\x89HDF\r\n\x1a\n"


def read_model(path: Path) -> Any:
    """The model in a netCDF file.

    Raises ``ValueError`` where the file is missing or damaged, or holds no model.
    """
    return model_of(read(path), path)


def transitions_of(dataset: xr.Dataset, path: Path) -> Transitions:
    """The transitions in what :func:`read` gave of ``path``; raises as :func:`read_model` does."""
    kind = dataset.attrs["kind"]
    if kind != TRANSITIONS:
        raise ValueError(
            f"{path} holds a model of kind {kind}, not transitions; give what ocp collect wrote, or"
            " a table"
        )
    return _made(Transitions, dataset, path)


def model_of(dataset: xr.Dataset, path: Path) -> Any:
    """The model in what :func:`read` gave of ``path``; raises as :func:`read_model` does."""
    kind = dataset.attrs["kind"]
    if kind == TRANSITIONS:
        raise ValueError(f"{path} holds transitions, not a model; learn one from them: ocp learn")
    from dynamics.learned.ewda import EwdaModel
    from dynamics.learned.mlp import MlpModel

    return _made(EwdaModel if kind == EWDA else MlpModel, dataset, path)


def _made(kind: Any, dataset: xr.Dataset, path: Path) -> Any:
    try:
        return kind.of(dataset)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read(path: Path) -> xr.Dataset:
    """Everything in a file of transitions or of a model, its checksum compared.

    Raises ``ValueError`` where a file is missing, truncated or changed, or is something
    else.
    """
    import xarray as xr

    if not path.is_file():
        found = "is a directory" if path.is_dir() else "file not found"
        raise ValueError(f"{path}: {found}; ocp collect writes data and ocp learn writes models")
    with path.open("rb") as file:
        if file.read(len(_HDF)) != _HDF:
            raise ValueError(
                f"{path} is not a netCDF file; ocp collect writes data and ocp learn writes models"
            )
    try:
        dataset = xr.load_dataset(path, engine="netcdf4", mask_and_scale=False, decode_times=False)
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        raise ValueError(f"{path} is truncated or damaged; create it again") from error
    kind = plain(dataset.attrs.get("kind"))
    if kind not in KINDS:
        raise ValueError(
            f"{path} is not a file of this program: its kind is {kind!r}, expected"
            f" {', '.join(KINDS)}"
        )
    if plain(dataset.attrs.get(CHECKSUM)) != checksum(dataset):
        raise ValueError(
            f"{path} does not match its checksum: truncated or changed; create it again"
        )
    return dataset


def checksum(dataset: xr.Dataset) -> str:
    """SHA-256 over names, shapes, values and attributes, but for the checksum's own."""
    digest = hashlib.sha256()
    for name in sorted(map(str, dataset.variables)):
        values = np.asarray(dataset.variables[name].values)
        digest.update(json.dumps([name, dataset[name].dims, values.shape], default=str).encode())
        numeric = values.dtype.kind in "biuf"
        text = "" if numeric else json.dumps(values.tolist(), default=str)
        digest.update(values.tobytes() if numeric else text.encode())
    attributes = {key: plain(value) for key, value in dataset.attrs.items() if key != CHECKSUM}
    digest.update(json.dumps(attributes, sort_keys=True).encode())
    return digest.hexdigest()
