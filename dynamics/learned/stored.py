"""Schema of the files of transitions and models; it is checked before an object is built from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Json, ValidationError

if TYPE_CHECKING:
    import xarray as xr

# Version of the schema.
SCHEMA = 1
# Kinds of files: transitions, and models, with the name of their contact law.
TRANSITIONS = "transitions"
EWDA = "ewda"
MLP = "mlp"
KINDS = (TRANSITIONS, EWDA, MLP)
LARGEST_NUMBER = 1e50
"""Maximum absolute value of a number in a file, so that sums and products of a few numbers are finite."""
_Count = Annotated[int, Field(ge=0)]


class _Attributes(BaseModel):
    """Attributes of files of all kinds."""

    model_config = ConfigDict(strict=True)

    problem: str
    parameters: Json[dict[str, bool | int | float | str | list[float]]]
    data_hash: str
    provenance: Json[dict[str, Any]] = Field(default="{}", validate_default=True)


class _Model(_Attributes):
    sigma: Annotated[float, Field(ge=0, le=LARGEST_NUMBER)]
    seed: int
    data_rows: _Count = 0
    held_out: _Count = 0


class _Network(_Model):
    activation: Literal["elu"]
    layers: Annotated[int, Field(ge=1, le=100)]


# Mapping from the kind of a file to the model of its attributes.
_ATTRIBUTES: dict[str, type[_Attributes]] = {
    TRANSITIONS: _Attributes,
    EWDA: _Model,
    MLP: _Network,
}
# Mapping from the name of a variable to its dimensions.
_DIMENSIONS = {
    **dict.fromkeys(("z", "z_unit", "z_shift", "z_scale", "z_least", "z_most"), ("z",)),
    **dict.fromkeys(("state", "state_unit", "y_shift", "y_scale"), ("state",)),
    **dict.fromkeys(("fit_y_scale", "fit_clean", "fit_noised"), ("state",)),
    **dict.fromkeys(("fit_distance", "fit_displacement", "fit_outside"), ("fit_distance",)),
    **dict.fromkeys(("input", "input_unit"), ("input",)),
    **{"fit_sigma": (), "z_data": ("sample", "z"), "y_data": ("sample", "state")},
    **{"x": ("sample", "state"), "x_next": ("sample", "state"), "u": ("sample", "input")},
}
# Variables whose values are text.
_TEXT_VARIABLES = ("z", "z_unit", "state", "state_unit", "input", "input_unit")
# Mapping from the kind of a file to the variables that it needs in addition to the common ones.
_VARIABLES_OF_KIND = {
    TRANSITIONS: ("x", "u", "x_next", "input", "input_unit"),
    EWDA: ("z_data", "y_data"),
    MLP: ("y_shift", "y_scale"),
}
# Variables of files with the errors of a model's fit.
_FIT_VARIABLES = ("z_least", "z_most", *(name for name in _DIMENSIONS if name.startswith("fit_")))


def check_dataset(dataset: xr.Dataset, kind: str) -> None:
    """Raise ``ValueError`` if a dataset does not have the schema of its ``kind``.

    The check covers attributes, variables, their dimensions and types, the signs of scales and
    errors, and that the absolute values of numbers are at most :data:`LARGEST_NUMBER`.
    """
    attributes = {key: plain_value(value) for key, value in dataset.attrs.items()}
    if attributes.get("kind") != kind:
        raise ValueError(f"expected a file of kind {kind!r}, found {attributes.get('kind')!r}")
    if attributes.get("schema") != SCHEMA:
        raise ValueError(f"its schema is {attributes.get('schema')}, this version reads {SCHEMA}; create it again")
    try:
        _ATTRIBUTES[kind].model_validate(attributes)
    except ValidationError as error:
        first_error = error.errors()[0]
        raise ValueError(f"{'.'.join(map(str, first_error['loc']))}: {first_error['msg']}") from error
    layers = range(attributes["layers"] if kind == MLP else 0)
    required_names = [f"{array}_{layer}" for layer in layers for array in ("weight", "bias")]
    required_names += [*_VARIABLES_OF_KIND[kind], "z", "z_unit", "z_shift", "z_scale", "state", "state_unit"]
    required_names += _FIT_VARIABLES if "data_rows" in attributes else ()
    if missing := [name for name in required_names if name not in dataset.variables]:
        raise ValueError(f"it lacks {', '.join(missing)}; create it again")
    for name in dataset.variables:
        _check_variable(str(name), dataset)
    size = dataset.sizes["z"]
    for layer in layers:
        weight, bias = dataset[f"weight_{layer}"].shape, dataset[f"bias_{layer}"].shape
        if len(bias) != 1 or weight != (*bias, size):
            raise ValueError(f"weight_{layer} does not fit the layer before it")
        (size,) = bias
    if layers and size != dataset.sizes["state"]:
        raise ValueError(f"bias_{layers[-1]} has {size} entries, and there are {dataset.sizes['state']} states")


def _check_variable(name: str, dataset: xr.Dataset) -> None:
    variable = dataset.variables[name]
    if name in _DIMENSIONS and variable.dims != _DIMENSIONS[name]:
        raise ValueError(f"{name} is over {variable.dims}, expected {_DIMENSIONS[name]}")
    values = np.asarray(variable.values)
    if name in _TEXT_VARIABLES:
        if not all(isinstance(label, str) for label in values.ravel().tolist()):
            raise ValueError(f"{name} does not hold text only")
        return
    if values.dtype.kind not in "iuf":
        raise ValueError(f"{name} does not hold numbers only")
    # A comparison with NaN is false, so that NaN is rejected too.
    if not (np.abs(values) <= LARGEST_NUMBER).all():
        raise ValueError(f"{name} holds numbers that are not finite or beyond {LARGEST_NUMBER:g}")
    if name.endswith("_scale") and not (values > 0).all():
        raise ValueError(f"{name} holds scales that are not above 0")
    if name.startswith("fit_") and not (values >= 0).all():
        raise ValueError(f"{name} holds errors below 0")


def plain_value(value: Any) -> Any:
    """Return an attribute as a Python value, converted from NumPy if needed."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value
