"""From words on the command line to values and laws; :mod:`ocp.choices` knows the names."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from ocp.errors import InputError

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from dynamics.systems import ContactSystem


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
    """Make the law called ``name`` from what ``-c`` gave."""
    from ocp import choices

    return choices.contact_law(name, assignments("-c", given))


def closing_law(name: str, given: Iterable[str] | None, system: ContactSystem) -> ContactLaw:
    """Make a law that can close ``system``; raises InputError where it cannot."""
    from ocp import choices

    return choices.closing_law(name, assignments("-c", given), system)


def whole(option: str, text: str) -> int:
    """Read a count such as ``100000`` or ``1e5``; raises InputError for anything else."""
    from ocp.words.numbers import typed

    try:
        return typed(text, int)
    except ValueError as error:
        example = "" if "most" in str(error) else " such as 100000 or 1e5"
        raise InputError(f"{option} must be {error}{example}, got {text!r}") from None
