"""Make laws, methods and policies from names and settings; errors list the valid names."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from dynamics.contact import ContactLaw
from ocp.errors import InputError, choose, did_you_mean, input_errors
from ocp.policy import POLICIES, Policy
from ocp.transcription import METHODS, Method

if TYPE_CHECKING:
    from dynamics.systems import ContactSystem

T = TypeVar("T")
DEFAULT_LAW = "exact"
"""The law of plans where none is chosen: docs/theory/laws.md compares it with the barrier."""


def contact_law(contact: ContactLaw | str, values: Mapping[str, Any]) -> ContactLaw:
    """Make the law called ``contact`` from its settings; ``base.<k>`` go to the base law.

    A law that is made already is taken as it is, and takes no settings.
    """
    from dynamics.laws import LAWS

    if isinstance(contact, ContactLaw):
        _refuse(values, f"the law is made already; give it to {type(contact).__name__}(...)")
        return contact
    choose("contact law", contact, LAWS)
    inner = {key.removeprefix("base."): v for key, v in values.items() if key.startswith("base.")}
    outer: dict[str, Any] = {k: v for k, v in values.items() if not k.startswith("base.")}
    takes_base = "base" in inspect.signature(LAWS[contact]).parameters
    if inner and "base" not in outer:
        key = f"base.{next(iter(inner))}"
        hint = "name the base law as well, with base=barrier" if takes_base else "drop it"
        raise InputError(f"{key}: {contact} has no base law here; {hint}")
    if takes_base and "base" in outer:
        if isinstance(outer["base"], str):
            choose("base law", outer["base"], LAWS)
        outer["base"] = contact_law(outer["base"], inner)
    return _construct("contact law", contact, LAWS[contact], outer)


def law_settings(contact: ContactLaw | str) -> tuple[str, ...]:
    """Names of the settings that a law takes when it is chosen by name; none if made already."""
    from dynamics.laws import LAWS

    if isinstance(contact, ContactLaw):
        return ()
    return tuple(inspect.signature(choose("contact law", contact, LAWS)).parameters)


def laws_with(setting: str) -> str:
    """The part of a sentence that names the laws which take ``setting``; "" where none does."""
    from dynamics.laws import LAWS

    names = [name for name, law in LAWS.items() if setting in inspect.signature(law).parameters]
    return f"; {setting} belongs to {', '.join(names)}" if names else ""


def closing_law(
    contact: ContactLaw | str, values: Mapping[str, Any], system: ContactSystem
) -> ContactLaw:
    """Make a law that can close ``system``; raises InputError where it cannot."""
    law = contact_law(contact, values)
    with input_errors():
        law.parameters(system)
    return law


def method_of(method: Method | str) -> Method:
    """Make the method called ``method``, or take it as it is."""
    return choose("method", method, METHODS)() if isinstance(method, str) else method


def policy_of(policy: Policy | str, values: Mapping[str, Any]) -> Policy:
    """Make the policy called ``policy`` from its settings, or take it as it is, without any."""
    if isinstance(policy, str):
        return _construct("policy", policy, choose("policy", policy, POLICIES), values)
    _refuse(values, f"the policy is made already; give it to {type(policy).__name__}(...)")
    return policy


def split_policy_settings(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Separate ``policy.<name>`` from the settings of method and solver."""
    own = {k.removeprefix("policy."): v for k, v in values.items() if k.startswith("policy.")}
    return own, {k: v for k, v in values.items() if not k.startswith("policy.")}


def _refuse(values: Mapping[str, Any], reason: str) -> None:
    if values:
        raise InputError(f"{', '.join(values)} cannot be set: {reason}")


def _construct(kind: str, name: str, cls: type[T], values: Mapping[str, Any]) -> T:
    takes = inspect.signature(cls).parameters
    where = "ocp settings " + name if kind == "policy" else "ocp laws " + name
    for key in values:
        if key not in takes:
            others = laws_with(key) if kind == "contact law" else ""
            raise InputError(
                f"{kind} {name} has no setting {key!r}{did_you_mean(key, takes)};"
                f" it takes {', '.join(takes) or 'none'}{others}; list them with {where}"
            )
    from ocp.validation import parse

    hints = get_type_hints(cls.__init__)
    typed = {key: parse(f"{name}: {key}", value, hints[key]) for key, value in values.items()}
    with input_errors(TypeError):
        return cls(**typed)
