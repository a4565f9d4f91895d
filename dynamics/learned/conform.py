"""Whether a file of transitions or of a model holds what its kind needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Json, ValidationError

if TYPE_CHECKING:
    import xarray as xr

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
