"""Parameters of a named problem: checked numbers with units, and their symbols."""

from __future__ import annotations

from typing import Any, TypedDict, Unpack

import casadi as ca
from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

from dynamics.systems import Parameter, ParameterTable
from ocp.problem.problem import Problem
from ocp.programs.units import SI, Units, fitted


class Parameters(BaseModel):
    """Base of every problem's parameters: finite numbers, nothing unknown, never changed.

    A ``float`` field becomes a symbol that a study may turn; an ``int`` field, or one made by
    :func:`structure`, shapes the problem (horizon, number of scenarios, seed) and stays a number.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class Limits(TypedDict, total=False):
    """A range: greater than ``above``, in [least, most]."""

    above: float
    least: float
    most: float


def declared(default: float, unit: str, meaning: str, limits: Limits, **extra: Any) -> Any:
    """Declare a number in ``unit`` within ``limits``, and what else is to be known of it."""
    return Field(
        default,
        gt=limits.get("above"),
        ge=limits.get("least"),
        le=limits.get("most"),
        description=meaning,
        json_schema_extra={"unit": unit, **extra},
    )


def quantity(default: float, unit: str, meaning: str, **limits: Unpack[Limits]) -> Any:
    """Declare a scalar in SI ``unit`` with its range, see :class:`Limits`."""
    return declared(default, unit, meaning, limits)


def structure(default: float, meaning: str, *, unit: str = "1", **limits: Unpack[Limits]) -> Any:
    """Declare a number >= 0 that shapes the problem, such as its horizon, and is never a symbol."""
    return declared(default, unit, meaning, {"least": 0, **limits}, structural=True)


def choice(words: tuple[str, ...], meaning: str) -> Any:
    """Declare a word out of ``words``, the first by default; it shapes the problem."""
    return Field(
        words[0],
        pattern=f"^({'|'.join(words)})$",
        description=meaning,
        json_schema_extra={"structural": True, "words": list(words)},
    )


def unit_of(field: FieldInfo) -> str:
    """Return the field's unit, ``"1"`` where none was declared."""
    extra = field.json_schema_extra
    return str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"


def is_structural(field: FieldInfo) -> bool:
    """Whether the field shapes the problem instead of becoming a symbol."""
    extra = field.json_schema_extra
    declared = isinstance(extra, dict) and bool(extra.get("structural"))
    return declared or field.annotation is not float


def range_of(field: FieldInfo) -> str:
    """Say in words which values the field takes, with its unit: ``"a number > 0 [kg]"``."""
    extra = field.json_schema_extra
    words = extra.get("words") if isinstance(extra, dict) else None
    if isinstance(words, list):
        return " or ".join(repr(word) for word in words)
    kind = {int: "a whole number", float: "a number"}.get(
        field.annotation or float, f"a {getattr(field.annotation, '__name__', field.annotation)}"
    )
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    limits = [
        f"{sign} {getattr(entry, attribute):g}"
        for entry in field.metadata
        for attribute, sign in signs.items()
        if getattr(entry, attribute, None) is not None
    ]
    unit = unit_of(field)
    return " and ".join([f"{kind} {limits[0]}", *limits[1:]] if limits else [kind]) + (
        "" if unit == "1" else f" [{unit}]"
    )


def table(params: BaseModel) -> ParameterTable:
    """Return the turnable parameters as fresh symbols with their values as defaults."""
    return ParameterTable(
        Parameter(name, float(getattr(params, name)), unit_of(field), field.description or "")
        for name, field in type(params).model_fields.items()
        if not is_structural(field)
    )


def natural_units(params: BaseModel, problem: Problem) -> Units:
    """Natural units that follow the parameters of a problem from their defaults.

    What is zero, or has changed its sign, says nothing; nor does a word or a setting. See
    :func:`~ocp.programs.units.fitted`.
    """
    fields = {n: f for n, f in type(params).model_fields.items() if not is_structural(f)}
    ratios = {
        name: float(getattr(params, name)) / float(field.default)
        for name, field in fields.items()
        if isinstance(field.default, (int, float)) and field.default
    }
    if all(ratio == 1 for ratio in ratios.values()):
        return SI
    # One weight alone is not told from the unit of the cost.
    weights = problem.weights if len(problem.weights) > 1 else set()
    return fitted((unit_of(fields[name]), ratio, name in weights) for name, ratio in ratios.items())


def friction_of(p: ParameterTable) -> tuple[ParameterTable, ca.SX | None]:
    """Return the parameters and Coulomb's coefficient, or without it and None where it is zero.

    A cone that has shrunk to a line has no inside for a central path: without friction there are
    no friction pairs, and no parameter ``friction`` to turn.
    """
    if p.get("friction").value > 0:
        return p, p["friction"]
    return ParameterTable(parameter for parameter in p if parameter.name != "friction"), None
