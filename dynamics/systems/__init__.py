"""What moves: systems as one implicit step with contact multipliers and gaps."""

from dynamics.systems.chain import Chain
from dynamics.systems.lcs import is_p_matrix, lcs
from dynamics.systems.machine import Machine, Part, Sphere
from dynamics.systems.mechanism import WORLD
from dynamics.systems.pairs import ContactForces, EnergyBook, Pair, Sharp
from dynamics.systems.parameters import (
    LAW_PREFIX,
    Parameter,
    ParameterTable,
    Signal,
    entries,
    signals,
)
from dynamics.systems.planar import Link
from dynamics.systems.system import ContactSystem, ReducedContact
from dynamics.systems.timestepping import quasi_dynamic, time_stepping

__all__ = [
    "LAW_PREFIX",
    "WORLD",
    "Chain",
    "ContactForces",
    "ContactSystem",
    "EnergyBook",
    "Link",
    "Machine",
    "Pair",
    "Parameter",
    "ParameterTable",
    "Part",
    "ReducedContact",
    "Sharp",
    "Signal",
    "Sphere",
    "entries",
    "is_p_matrix",
    "lcs",
    "quasi_dynamic",
    "signals",
    "time_stepping",
]
