"""What code gives for a part of a problem, as the type that is expected, or one sentence."""

from __future__ import annotations

from functools import cache
from types import GenericAlias
from typing import Annotated, Any

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
)

from ocp.errors import InputError, abbreviated


def _number(value: Any) -> Any:
    if isinstance(value, bool | np.bool_ | str | bytes | bytearray):
        raise ValueError("must be a number")
    single = isinstance(value, np.generic | np.ndarray) and value.shape == ()
    return _number(value.item()) if single else value


def _line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must be one line of text without control characters")
    return text


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
"""A finite number of Python's or NumPy's, and no word."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Count = Annotated[int, BeforeValidator(_number), Field(ge=1)]
Index = Annotated[int, BeforeValidator(_number), Field(ge=0)]
Line = Annotated[str, Field(strict=True), AfterValidator(_line)]
"""A text that fits into a line and a terminal."""
Scalar = bool | int | float | str
Recorded = Scalar | list[Scalar]
"""What the record of a run holds of a parameter or a setting."""


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    given = ConfigDict(arbitrary_types_allowed=True, revalidate_instances="always")
    # pydantic takes no configuration for a bare dataclass, but for a tuple of one.
    alone: Any = GenericAlias(tuple, (kind,))
    return TypeAdapter(alone, config=given)


def checked(what: str, value: Any, kind: Any) -> Any:
    """Return a ``value`` that code made as the type ``kind``; what it is made of is checked too.

    Raises :class:`~ocp.errors.InputError` that names the part of ``what`` that does not fit.
    """
    try:
        return _adapter(kind).validate_python((value,))[0]
    except ValidationError as error:
        # Of a union the branch that came furthest says what is wrong.
        found = max(error.errors(), key=lambda one: len(one["loc"]))
    place = _place(value, found["loc"][1:])
    _, should, expected = found["msg"].removeprefix("Value error, ").partition(" should ")
    expected = expected.replace("valid string", "text").replace("valid ", "")
    said = f"must {expected}" if should else found["msg"].removeprefix("Value error, ")
    raise InputError(f"{what}{place} {said}, got {abbreviated(found['input'])}")


def check_fields(instance: Any, what: str, **kinds: Any) -> None:
    """Make the fields of a frozen dataclass what ``kinds`` say; raises as :func:`checked`."""
    for name, kind in kinds.items():
        value = checked(f"{what}.{name}", getattr(instance, name), kind)
        object.__setattr__(instance, name, value)


def _place(value: Any, path: tuple[int | str, ...]) -> str:
    """The part at ``path`` as Python writes it, without pydantic's own words for branches."""
    written = ""
    for key in path:
        try:
            value, written = value[key], f"{written}[{key!r}]"
        except (TypeError, LookupError):
            if not hasattr(value, str(key)):
                break
            value, written = getattr(value, str(key)), f"{written}.{key}"
    return written
