"""Named contact problems, one per module; ``get(name, **params)`` builds one."""

from problems.parameters import Parameters, quantity, structure, table
from problems.registry import get, load, names, spec
from problems.spec import Citation, Golden, ProblemSpec, describe

__all__ = [
    "Citation",
    "Golden",
    "Parameters",
    "ProblemSpec",
    "describe",
    "get",
    "load",
    "names",
    "quantity",
    "spec",
    "structure",
    "table",
]
