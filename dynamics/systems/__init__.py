"""Mechanical systems as one implicit step with contact multipliers and gaps."""

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
from dynamics.systems.planar.chain import Chain
from dynamics.systems.planar.links import Link
from dynamics.systems.planar.machine import Machine, Part, Sphere
from dynamics.systems.system import ContactSystem, ReducedContact
from dynamics.systems.timestepping import quasi_dynamic, time_stepping

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
