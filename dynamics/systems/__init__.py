"""What moves: systems as one implicit step with contact multipliers and gaps."""

from dynamics.systems.lcs import is_p_matrix, lcs, linearise
from dynamics.systems.parameters import Parameter, ParameterTable, Signal, signals
from dynamics.systems.quasidynamic import quasi_dynamic
from dynamics.systems.system import AffineContact, ContactSystem
from dynamics.systems.timestepping import time_stepping

__all__ = [
    "AffineContact",
    "ContactSystem",
    "Parameter",
    "ParameterTable",
    "Signal",
    "is_p_matrix",
    "lcs",
    "linearise",
    "quasi_dynamic",
    "signals",
    "time_stepping",
]
