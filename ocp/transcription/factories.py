"""Construction of contact laws and policies from names and settings; errors list the valid names."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import casadi as ca

from dynamics.contact import ContactLaw
from dynamics.settings import settings_of
from ocp import plugins
from ocp.errors import InputError, choose, did_you_mean, input_errors
from ocp.problem.policy import POLICIES, Policy
from ocp.validation import expand_path

if TYPE_CHECKING:
    from dynamics.systems import ContactSystem, ParameterTable

T = TypeVar("T")
DEFAULT_LAW = "exact"
"""Default contact law of a solve; docs/theory/laws.md compares it with the barrier law."""


def contact_law(contact: ContactLaw | str, values: Mapping[str, Any]) -> ContactLaw:
    """Build the contact law called ``contact`` from its settings; settings of its base law are called ``base.<k>``.

    ``contact`` may also be the path of a file that defines a law (:func:`law_class`). A law object
    is returned unchanged, and no settings are allowed with it.
    """
    if isinstance(contact, ContactLaw):
        _refuse(values, f"the law is made already; give it to {type(contact).__name__}(...)")
        return contact
    law = law_class(contact)
    inner = {key.removeprefix("base."): v for key, v in values.items() if key.startswith("base.")}
    outer: dict[str, Any] = {k: v for k, v in values.items() if not k.startswith("base.")}
    takes_base = "base" in settings_of(law)
    if inner and "base" not in outer:
        key = f"base.{next(iter(inner))}"
        hint = "name the base law as well, with base=barrier" if takes_base else "drop it"
        raise InputError(f"{key}: {contact} has no base law here; {hint}")
    if takes_base and "base" in outer:
        if isinstance(outer["base"], str):
            law_class(outer["base"], "base law")
        outer["base"] = contact_law(outer["base"], inner)
    return _construct("contact law", contact, law, outer)


def law_class(contact: str, kind: str = "contact law") -> type[ContactLaw]:
    """Return the class of the contact law called ``contact``, or of the law in a user's file (``*.py``).

    Raises :class:`~ocp.errors.InputError` for an unknown name, and as
    :func:`problems.registry.load_law` does.
    """
    from dynamics.laws import LAWS

    if contact.endswith(".py"):
        return plugins.problems.load_law(contact)
    if contact not in LAWS:
        raise InputError(
            f"unknown {kind} {contact!r}{did_you_mean(contact, LAWS)}; there are {', '.join(LAWS)},"
            " or give the path of a file such as my_law.py"
        )
    return LAWS[contact]


def law_name(contact: ContactLaw | str) -> str:
    """Return the name of a contact law, or the path of its file, as accepted by :func:`law_class`."""
    from dynamics.laws import LAWS

    if isinstance(contact, str):
        is_file = contact.endswith(".py")
        return str(expand_path(contact).resolve()) if is_file else contact
    if type(contact) in LAWS.values():
        return contact.name
    return contact.source or inspect.getsourcefile(type(contact)) or contact.name


def law_record(law: ContactLaw) -> dict[str, Any]:
    """Return the entries that a run stores about its contact law, including path and digest of a user's file."""
    origin = {"contact_source": law.source, "contact_digest": law.source_digest}
    return {"contact": law.name, "contact_settings": law.settings(), **(origin if law.source else {})}


def law_digest(contact: ContactLaw | str) -> str | None:
    """Return the digest of the file that defines a law; None for a built-in law or a law made in Python."""
    if isinstance(contact, str) and not contact.endswith(".py"):
        return None
    return (law_class(contact) if isinstance(contact, str) else contact).source_digest


def law_settings(contact: ContactLaw | str) -> tuple[str, ...]:
    """Return the names of the settings of a law given by name; empty for a law object."""
    if isinstance(contact, ContactLaw):
        return ()
    return tuple(settings_of(law_class(contact)))


def laws_with(setting: str) -> str:
    """Return the end of an error message: the laws with this ``setting``; empty if there is none."""
    from dynamics.laws import LAWS

    names = [name for name, law in LAWS.items() if setting in settings_of(law)]
    return f"; {setting} belongs to {', '.join(names)}" if names else ""


def make_law(contact: ContactLaw | str, values: Mapping[str, Any], system: ContactSystem) -> ContactLaw:
    """Build a contact law for ``system``; raise InputError if the law is not suitable for the system."""
    from dynamics.laws import LAWS

    law = contact_law(contact, values)
    with input_errors():
        p = law.parameters(system)
        if type(law) not in LAWS.values():
            _check_target(law, system, p)
    return law


def _check_target(law: ContactLaw, system: ContactSystem, p: ParameterTable) -> None:
    """Raise ValueError unless a user's law returns one mu for each pair in ``system.deciding_pairs``."""
    n = len(set(system.deciding_pairs))
    mu = ca.SX(law.target(system, ca.SX.sym("z", n), ca.SX.sym("F", n, n), p))
    if mu.shape != (n, 1):
        raise ValueError(
            f"{law.name}: target(system, z, F, p) must return mu of shape ({n}, 1), as z has, got {mu.shape}"
        )


def policy_of(policy: Policy | str, values: Mapping[str, Any]) -> Policy:
    """Build the policy called ``policy`` from its settings; a policy object is returned unchanged."""
    if isinstance(policy, str):
        return _construct("policy", policy, choose("policy", policy, POLICIES), values)
    _refuse(values, f"the policy is made already; give it to {type(policy).__name__}(...)")
    return policy


def split_policy_settings(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Separate settings ``policy.<name>`` from the settings of method and solver."""
    policy_settings = {k.removeprefix("policy."): v for k, v in values.items() if k.startswith("policy.")}
    return policy_settings, {k: v for k, v in values.items() if not k.startswith("policy.")}


def _refuse(values: Mapping[str, Any], reason: str) -> None:
    if values:
        raise InputError(f"{', '.join(values)} cannot be set: {reason}")


def _construct(kind: str, name: str, cls: type[T], values: Mapping[str, Any]) -> T:
    takes = settings_of(cls)
    for key in values:
        if key not in takes:
            other_laws = laws_with(key) if kind == "contact law" else ""
            raise InputError(
                f"{kind} {name} has no setting {key!r}{did_you_mean(key, takes)};"
                f" it takes {', '.join(takes) or 'none'}{other_laws}; see ocp settings {name}"
            )
    read = {key: takes[key].read(value, f"{name}: ") for key, value in values.items()}
    with input_errors(TypeError):
        return cls(**read)
