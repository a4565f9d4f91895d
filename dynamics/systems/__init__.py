"""Mechanical systems as one implicit step with contact multipliers and gaps."""

from importlib import import_module
from typing import TYPE_CHECKING

from dynamics.systems.lcs import is_p_matrix, lcs
from dynamics.systems.mechanism import WORLD
from dynamics.systems.pairs import ContactForces, EnergyBalance, Pair, RefereeModel
from dynamics.systems.parameters import (
    LAW_PREFIX,
    Parameter,
    ParameterTable,
    Signal,
    matrix_parameters,
    signals,
)
from dynamics.systems.planar.links import Link
from dynamics.systems.system import ContactSystem, ReducedContact
from dynamics.systems.timestepping import quasi_dynamic, time_stepping

if TYPE_CHECKING:
    from dynamics.systems.planar.chain import Chain
    from dynamics.systems.planar.machine import Machine, Part, Sphere

__all__ = [
    "LAW_PREFIX",
    "WORLD",
    "Chain",
    "ContactForces",
    "ContactSystem",
    "EnergyBalance",
    "Link",
    "Machine",
    "Pair",
    "Parameter",
    "ParameterTable",
    "Part",
    "ReducedContact",
    "RefereeModel",
    "Signal",
    "Sphere",
    "is_p_matrix",
    "lcs",
    "matrix_parameters",
    "quasi_dynamic",
    "signals",
    "time_stepping",
]

_LOADED_ON_USE = {
    "Chain": "dynamics.systems.planar.chain",
    "Machine": "dynamics.systems.planar.machine",
    "Part": "dynamics.systems.planar.machine",
    "Sphere": "dynamics.systems.planar.machine",
}
"""Mapping from public names to their modules, which are imported at first use: few problems are machines."""


# Hidden from type checkers, which would otherwise accept any name in the module.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Return an object of :data:`_LOADED_ON_USE`; its module is imported at the first use."""
        if name in _LOADED_ON_USE:
            return getattr(import_module(_LOADED_ON_USE[name]), name)
        raise AttributeError(f"module 'dynamics.systems' has no attribute {name!r}")
