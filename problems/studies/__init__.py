"""Studies: one figure of a paper each, one a folder; ``get("P6").data()`` runs one."""

from ocp.errors import choose
from problems.studies.catalogue import STUDIES
from problems.studies.study import Claim, Study


def ids() -> list[str]:
    """Identifiers of all studies, in the order of the papers."""
    return list(STUDIES)


def get(name: str) -> Study:
    """Return the study called ``name``, upper or lower case.

    Raises :class:`~ocp.errors.InputError` for an unknown one.
    """
    known = {identifier.lower(): identifier for identifier in STUDIES}
    return choose("figure", known.get(name.lower(), name), STUDIES)


__all__ = ["Claim", "Study", "get", "ids"]
