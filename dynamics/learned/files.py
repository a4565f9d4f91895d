"""Reading transitions and models from their files: arrays and attributes in netCDF, never code."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.learned.conform import misfit
from dynamics.learned.transitions import KIND as TRANSITIONS
from dynamics.learned.transitions import Transitions

if TYPE_CHECKING:
    import xarray as xr

MODELS = ("ewda", "mlp")
CHECKSUM = "checksum"
_HDF = b"\x89HDF\r\n\x1a\n"


def read_model(path: Path) -> Any:
    """The model in a netCDF file.

    Raises ``ValueError`` where there is no such file, it is damaged, or it holds no model.
    """
    return model_of(read(path), path)


def transitions_of(dataset: xr.Dataset, path: Path) -> Transitions:
    """The transitions in what :func:`read` gave of ``path``; raises as :func:`read_model` does."""
    kind = dataset.attrs["kind"]
    if kind != TRANSITIONS:
        raise ValueError(
            f"{path} holds a model of kind {kind}, no transitions; give what ocp collect wrote, or"
            " a table"
        )
    try:
        return Transitions.of(dataset)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def model_of(dataset: xr.Dataset, path: Path) -> Any:
    """The model in what :func:`read` gave of ``path``; raises as :func:`read_model` does."""
    kind = dataset.attrs["kind"]
    if kind == TRANSITIONS:
        raise ValueError(f"{path} holds transitions, no model; learn one from them: ocp learn")
    try:
        return _class(kind).of(dataset)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    except KeyError as error:
        raise ValueError(f"{path}: the model lacks {error}; learn it again") from error


def read(path: Path) -> xr.Dataset:
    """Everything in a file of transitions or of a model, its checksum compared.

    Raises ``ValueError`` where there is no such file, it is cut short or changed, or is something
    else.
    """
    import xarray as xr

    if not path.is_file():
        found = "is a directory" if path.is_dir() else "there is no such file"
        raise ValueError(f"{path}: {found}; ocp collect makes data and ocp learn makes models")
    with path.open("rb") as file:
        if file.read(len(_HDF)) != _HDF:
            raise ValueError(
                f"{path} is no netCDF file; ocp collect makes data and ocp learn makes models"
            )
    try:
        dataset = xr.load_dataset(path, engine="netcdf4", mask_and_scale=False, decode_times=False)
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        raise ValueError(f"{path} is cut short or damaged; make it again") from error
    attributes = {key: _plain(value) for key, value in dataset.attrs.items()}
    kind = attributes.get("kind")
    if kind not in (TRANSITIONS, *MODELS):
        known = ", ".join((TRANSITIONS, *MODELS))
        raise ValueError(
            f"{path} is a netCDF file of something else: its kind is {kind!r}, expected {known}"
        )
    if attributes.get(CHECKSUM) != checksum(dataset):
        raise ValueError(f"{path} does not match its checksum: cut short or changed; make it again")
    if wrong := misfit(dataset, attributes):
        raise ValueError(f"{path} is no file of kind {kind} that this program wrote: {wrong}")
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
    told = {key: _plain(value) for key, value in dataset.attrs.items() if key != CHECKSUM}
    digest.update(json.dumps(told, sort_keys=True).encode())
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def _class(kind: str) -> Any:
    """The class of models of a kind, loaded when one is read."""
    if kind == "ewda":
        from dynamics.learned.ewda import EwdaModel

        return EwdaModel
    from dynamics.learned.mlp import MlpModel

    return MlpModel
