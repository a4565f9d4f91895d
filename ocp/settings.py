"""Read ``-s key=value`` settings: a few of our own, the rest the solver's."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from pydantic import Field

from ocp.errors import choose
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES
from ocp.validation import number, parse, whole


@dataclass(frozen=True)
class Settings:
    """Validated settings; ``options`` go to the solver, which knows their types."""

    homotopy: Annotated[
        bool | None,
        "follow a law's smoothing down from a wide start; not given: where the law smooths. Exact"
        " law in shooting: true follows the barrier law down, false is the gradient method alone,"
        " not given rolls out the plan of the direct transcription",
    ] = None
    strategy: Annotated[
        str, f"how a direct transcription meets exact complementarity: {', '.join(STRATEGIES)}"
    ] = DEFAULT_STRATEGY
    factor: Annotated[
        Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None,
        "by which the homotopy's parameter shrinks, between 0 and 1; not given: the law's own",
    ] = None
    start: Annotated[
        Annotated[float, Field(gt=0, allow_inf_nan=False)] | None,
        "first value of the homotopy's parameter; not given: from the sizes of the problem",
    ] = None
    jit: Annotated[bool, "evaluate by compiled C, cached, where a compiler is found"] = False
    options: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, raw: Mapping[str, Any]) -> Settings:
        """Read strings (or values) by key; raises :class:`~ocp.errors.InputError`."""
        types = get_type_hints(cls, include_extras=True)
        own = {key: parse(f"setting {key}", raw[key], types[key]) for key in OWN if key in raw}
        if "strategy" in own:
            choose("strategy", own["strategy"], STRATEGIES)
        options = {k.removeprefix("ipopt."): literal(v) for k, v in raw.items() if k not in OWN}
        return cls(**own, options=options)


@dataclass(frozen=True)
class Setting:
    """A setting as it was declared: name, kind of value, default (None for none) and meaning."""

    name: str
    kind: str
    default: Any
    meaning: str


def declared(cls: type) -> list[Setting]:
    """Settings of a class: the arguments that make one and are ``Annotated`` with their meaning."""
    found = []
    for name, argument in inspect.signature(cls).parameters.items():
        hint = _hint(cls, name)
        said = [word for word in getattr(hint, "__metadata__", ()) if isinstance(word, str)]
        if said:
            default = None if argument.default is argument.empty else argument.default
            found.append(Setting(name, _kind(hint), default, said[0]))
    return found


def _hint(cls: type, name: str) -> Any:
    """Type of an argument that makes ``cls``; None where only type checkers know it."""
    owner = next((base for base in cls.__mro__ if name in vars(base).get("__annotations__", {})),
                 cls.__init__)  # fmt: skip
    scope = vars(sys.modules[owner.__module__])
    with suppress(NameError):
        alone = SimpleNamespace(__annotations__={name: owner.__annotations__[name]})
        return get_type_hints(alone, scope, include_extras=True)[name]
    return None


def _kind(hint: Any) -> str:
    """The first type among the alternatives of ``hint`` in words."""
    while get_origin(hint) is Annotated or (get_args(hint) and get_origin(hint) is not tuple):
        hint = get_args(hint)[0]
    words = {bool: "true or false", int: "whole number", float: "number", str: "word"}
    return words.get(hint, "whole numbers" if get_origin(hint) is tuple else "name")


OWN = {setting.name: setting.meaning for setting in declared(Settings)}
"""Our own settings of a solve, with their meanings."""


def literal(value: Any) -> Any:
    """Turn a word into an int, float or bool where it reads as one (:mod:`ocp.validation`)."""
    if not isinstance(value, str):
        return value
    if (found := number(value)) is not None:
        written = value.strip().lstrip("+-").isdigit()
        return whole(value) if written else found
    return {"true": True, "false": False}.get(value.lower(), value)
