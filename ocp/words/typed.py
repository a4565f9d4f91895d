"""A word or a value as the type that is expected, or one sentence."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError

from ocp.errors import InputError
from ocp.words.numbers import typed

_KINDS = {
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "finite": "a finite number",
    "less": "between 0 and 1",
    "greater": "a positive finite number",
}
"""What to expect, by the first word of pydantic's name for what was wrong."""


def read(what: str, value: Any, kind: Any) -> Any:
    """Return ``value``, a word or already a value, as the type ``kind``.

    Numbers are written as :mod:`ocp.words.numbers` has it.

    Raises :class:`~ocp.errors.InputError` that says what was expected of ``what``.
    """
    try:
        number = typed(value, kind)
    except ValueError as error:
        raise InputError(f"{what} must be {error}, got {value!r}") from None
    try:
        adapter = TypeAdapter(kind, config=ConfigDict(arbitrary_types_allowed=True))
        return adapter.validate_python(number)
    except ValidationError as error:
        known = (_KINDS.get(found["type"].partition("_")[0]) for found in error.errors())
        expected = next((words for words in known if words), error.errors()[0]["msg"].lower())
        raise InputError(f"{what} must be {expected}, got {value!r}") from None
