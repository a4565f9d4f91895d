"""From words on the command line to laws, methods and policies; unknown words list the choices."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from ocp.errors import InputError, choose, did_you_mean

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from dynamics.systems import ContactSystem
    from ocp.policy import Policy

T = TypeVar("T")


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
    from dynamics.laws import LAWS

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


def closing_law(name: str, given: Iterable[str] | None, system: ContactSystem) -> ContactLaw:
    """Make a law that can close ``system``; raises InputError where it cannot."""
    law = contact_law(name, given)
    try:
        law.knobs(system)
    except ValueError as error:
        raise InputError(str(error)) from error
    return law


def policy(name: str, values: Mapping[str, str]) -> Policy:
    """Make the policy called ``name`` from its settings."""
    from ocp.policy import POLICIES

    return _construct("policy", name, choose("policy", name, POLICIES), values)


def split_policy_settings(values: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Separate ``policy.<name>`` from the settings of method and solver."""
    own = {k.removeprefix("policy."): v for k, v in values.items() if k.startswith("policy.")}
    return own, {k: v for k, v in values.items() if not k.startswith("policy.")}


def _construct(kind: str, name: str, cls: type[T], values: Mapping[str, Any]) -> T:
    takes = inspect.signature(cls).parameters
    where = "ocp settings " + name if kind == "policy" else "ocp laws " + name
    for key in values:
        if key not in takes:
            raise InputError(
                f"{kind} {name} has no setting {key!r}{did_you_mean(key, takes)};"
                f" it takes {', '.join(takes) or 'none'}; {where} tells them"
            )
    from ocp.settings import read

    hints = get_type_hints(cls.__init__)
    typed = {key: read(f"{name}: {key}", value, hints[key]) for key, value in values.items()}
    try:
        return cls(**typed)
    except (ValueError, TypeError) as error:
        raise InputError(str(error)) from error


def whole(option: str, text: str) -> int:
    """Read a count such as ``100000`` or ``1e5``; raises InputError for anything else."""
    try:
        value = float(text)
        if value.is_integer():
            return int(value)
    except (ValueError, OverflowError):
        pass
    raise InputError(f"{option} must be a whole number such as 100000 or 1e5, got {text!r}")
