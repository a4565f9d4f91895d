"""From words on the command line to laws, methods and policies; unknown words list the choices."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from ocp.errors import InputError

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from ocp.policy import Policy

T = TypeVar("T")

BACKENDS = ("auto", "c", "numpy", "casadi")
"""What evaluates many samples at once; auto takes the first that can be built."""


def choose(kind: str, name: str, known: Mapping[str, T]) -> T:
    """Return ``known[name]``; raises InputError with the nearest name and the list."""
    from problems.spec import did_you_mean

    if name not in known:
        raise InputError(
            f"unknown {kind} {name!r}{did_you_mean(name, known)};"
            f" there {'is' if len(known) == 1 else 'are'} {', '.join(known)}"
        )
    return known[name]


def assignments(option: str, given: Iterable[str] | None) -> dict[str, str]:
    """Read ``["a=1", "b=x"]``; raises InputError for anything else and for a name given twice."""
    values: dict[str, str] = {}
    for item in given or ():
        name, sign, value = (part.strip() for part in item.partition("="))
        if not (name and sign and value):
            raise InputError(f"{option}: expected name=value, got {item!r}; say {option} name=1.0")
        if name in values:
            raise InputError(f"{option}: {name} is given twice; give it once")
        values[name] = value
    return values


def contact_law(name: str, given: Iterable[str] | None) -> ContactLaw:
    """Make the law called ``name`` from its ``-c`` settings; ``base.<k>`` go to the base law."""
    from dynamics.contact import LAWS

    choose("contact law", name, LAWS)
    values = assignments("-c", given)
    inner = {key.removeprefix("base."): v for key, v in values.items() if key.startswith("base.")}
    outer: dict[str, Any] = {k: v for k, v in values.items() if not k.startswith("base.")}
    takes_base = "base" in inspect.signature(LAWS[name]).parameters
    if inner and "base" not in outer:
        key = f"base.{next(iter(inner))}"
        hint = "name the base law as well, with -c base=barrier" if takes_base else "drop it"
        raise InputError(f"-c {key}: {name} has no base law here; {hint}")
    if takes_base and "base" in outer:
        choose("base law", outer["base"], LAWS)
        outer["base"] = _construct("contact law", outer["base"], LAWS[outer["base"]], inner)
    return _construct("contact law", name, LAWS[name], outer)


def policy(name: str, values: Mapping[str, str]) -> Policy:
    """Make the policy called ``name`` from its settings."""
    from ocp.policy import POLICIES

    return _construct("policy", name, choose("policy", name, POLICIES), values)


def split_policy_settings(values: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Separate ``policy.<name>`` from the settings of method and solver."""
    own = {k.removeprefix("policy."): v for k, v in values.items() if k.startswith("policy.")}
    return own, {k: v for k, v in values.items() if not k.startswith("policy.")}


def _construct(kind: str, name: str, cls: type[T], values: Mapping[str, Any]) -> T:
    parameters = inspect.signature(cls).parameters
    for key in values:
        if key not in parameters:
            from problems.spec import did_you_mean

            takes = ", ".join(parameters) or "none"
            raise InputError(
                f"{kind} {name} has no setting {key!r}{did_you_mean(key, parameters)};"
                f" it takes {takes}"
            )
    typed = {
        key: _convert(f"{name}: {key}", value, str(parameters[key].annotation))
        for key, value in values.items()
    }
    try:
        return cls(**typed)
    except (ValueError, TypeError) as error:
        raise InputError(str(error)) from error


def _convert(what: str, value: Any, annotation: str) -> Any:
    """Read a setting as the type its annotation names; text stays text."""
    if not isinstance(value, str) or "str" in annotation:
        return value
    if "bool" in annotation:
        words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
        if value.lower() not in words:
            raise InputError(f"{what} must be true or false, got {value!r}")
        return words[value.lower()]
    whole = "int" in annotation
    try:
        return int(value) if whole else float(value)
    except ValueError:
        kind = "a whole number" if whole else "a number"
        raise InputError(f"{what} must be {kind}, got {value!r}") from None
