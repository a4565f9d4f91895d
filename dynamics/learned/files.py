"""Reading transitions and models from their files: arrays and attributes in netCDF, never code."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Json, ValidationError

from dynamics.learned.transitions import KIND as TRANSITIONS
from dynamics.learned.transitions import Transitions

if TYPE_CHECKING:
    import xarray as xr

MODELS = ("ewda", "mlp")
CHECKSUM = "checksum"
_HDF = b"\x89HDF\r\n\x1a\n"


def read_model(path: Path) -> Any:
    """The model in a netCDF file.

    Raises ``ValueError`` where file not found, it is damaged, or it holds no model.
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
    try:
        return Transitions.of(dataset)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def model_of(dataset: xr.Dataset, path: Path) -> Any:
    """The model in what :func:`read` gave of ``path``; raises as :func:`read_model` does."""
    kind = dataset.attrs["kind"]
    if kind == TRANSITIONS:
        raise ValueError(f"{path} holds transitions, not a model; learn one from them: ocp learn")
    try:
        return _class(kind).of(dataset)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    except KeyError as error:
        raise ValueError(f"{path}: the model lacks {error}; train it again") from error


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
    attributes = {key: _plain(value) for key, value in dataset.attrs.items()}
    kind = attributes.get("kind")
    if kind not in (TRANSITIONS, *MODELS):
        known = ", ".join((TRANSITIONS, *MODELS))
        raise ValueError(
            f"{path} is not a file of this program: its kind is {kind!r}, expected {known}"
        )
    if attributes.get(CHECKSUM) != checksum(dataset):
        raise ValueError(
            f"{path} does not match its checksum: truncated or changed; create it again"
        )
    if wrong := misfit(dataset, attributes):
        raise ValueError(f"{path} is not a file of kind {kind} of this program: {wrong}")
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


LARGEST = 1e50
"""Sums and products of a few numbers of this size are finite."""
_Count = Annotated[int, Field(ge=0)]


class _Told(BaseModel):
    """Attributes that all kinds have."""

    model_config = ConfigDict(strict=True)

    problem: str
    parameters: Json[dict[str, bool | int | float | str | list[float]]]
    data_hash: str
    provenance: Json[dict[str, Any]] = Field(default="{}", validate_default=True)


class _Model(_Told):
    sigma: Annotated[float, Field(ge=0, le=LARGEST)]
    seed: int
    data_rows: _Count = 0
    held_out: _Count = 0


class _Network(_Model):
    activation: Literal["elu"]
    layers: Annotated[int, Field(ge=1, le=100)]


_TOLD: dict[str, type[_Told]] = {"transitions": _Told, "ewda": _Model, "mlp": _Network}
_DIMENSIONS = {
    **dict.fromkeys(("z", "z_unit", "z_shift", "z_scale", "z_least", "z_most"), ("z",)),
    **dict.fromkeys(("state", "state_unit", "y_shift", "y_scale"), ("state",)),
    **dict.fromkeys(("fit_y_scale", "fit_clean", "fit_noised"), ("state",)),
    **dict.fromkeys(("fit_distance", "fit_displacement", "fit_outside"), ("fit_distance",)),
    **dict.fromkeys(("input", "input_unit"), ("input",)),
    **{"fit_sigma": (), "z_data": ("sample", "z"), "y_data": ("sample", "state")},
    **{"x": ("sample", "state"), "x_next": ("sample", "state"), "u": ("sample", "input")},
}
_ALWAYS = ("z", "z_unit", "z_shift", "z_scale", "state", "state_unit")
_DESCRIBED = ("z_least", "z_most", *(name for name in _DIMENSIONS if name.startswith("fit_")))
_LABELS = ("z", "z_unit", "state", "state_unit", "input", "input_unit")


def misfit(dataset: xr.Dataset, attributes: dict[str, Any]) -> str:
    """Say what of a file is not as its ``kind`` needs it; empty where all is.

    ``attributes`` are those of the dataset as plain values. Types, dimensions and signs are checked
    and that numbers are finite and at most :data:`LARGEST`.
    """
    try:
        _TOLD[attributes["kind"]].model_validate(attributes)
    except ValidationError as error:
        found = error.errors()[0]
        return f"{'.'.join(map(str, found['loc']))}: {found['msg']}"
    needed = (*_ALWAYS, *(_DESCRIBED if "data_rows" in attributes else ()))
    if missing := [name for name in needed if name not in dataset.variables]:
        return f"it lacks {', '.join(missing)}"
    problems = (_misfit_of(str(name), dataset) for name in dataset.variables)
    return next(filter(None, problems), "")


def _misfit_of(name: str, dataset: xr.Dataset) -> str:
    variable = dataset.variables[name]
    if name in _DIMENSIONS and variable.dims != _DIMENSIONS[name]:
        return f"{name} is over {variable.dims}, expected {_DIMENSIONS[name]}"
    values = np.asarray(variable.values)
    if name in _LABELS:
        texts = all(isinstance(one, str) for one in values.ravel().tolist())
        return "" if texts else f"{name} holds something else than texts"
    if values.dtype.kind not in "iuf":
        return f"{name} holds something else than numbers"
    # NaN compares as false.
    if not (np.abs(values) <= LARGEST).all():
        return f"{name} holds numbers that are not finite or beyond {LARGEST:g}"
    if name.endswith("_scale") and not (values > 0).all():
        return f"{name} holds scales that are not above 0"
    if name.startswith("fit_") and not (values >= 0).all():
        return f"{name} holds errors below 0"
    return ""
