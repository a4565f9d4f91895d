"""What moves: systems as one implicit step with contact multipliers and gaps."""

from dynamics.systems.chain import Chain
from dynamics.systems.contact_rows import Touching
from dynamics.systems.dry_friction import dry_friction
from dynamics.systems.friction import Mechanism, frictional_time_stepping
from dynamics.systems.geometry import (
    ContactGeometry,
    Pose,
    disc_box,
    disc_capsule,
    disc_disc,
    disc_half_plane,
)
from dynamics.systems.lcs import is_p_matrix, lcs, linearise
from dynamics.systems.machine import Machine, Sphere
from dynamics.systems.pairs import ContactForces, EnergyBook, Pair
from dynamics.systems.parameters import KNOB, Parameter, ParameterTable, Signal, entries, signals
from dynamics.systems.planar import Link
from dynamics.systems.quasidynamic import quasi_dynamic
from dynamics.systems.sharp import Sharp
from dynamics.systems.system import ContactSystem, ReducedContact
from dynamics.systems.timestepping import time_stepping

__all__ = [
    "KNOB",
    "Chain",
    "ContactForces",
    "ContactGeometry",
    "ContactSystem",
    "EnergyBook",
    "Link",
    "Machine",
    "Mechanism",
    "Pair",
    "Parameter",
    "ParameterTable",
    "Pose",
    "ReducedContact",
    "Sharp",
    "Signal",
    "Sphere",
    "Touching",
    "disc_box",
    "disc_capsule",
    "disc_disc",
    "disc_half_plane",
    "dry_friction",
    "entries",
    "frictional_time_stepping",
    "is_p_matrix",
    "lcs",
    "linearise",
    "quasi_dynamic",
    "signals",
    "time_stepping",
]
