"""Many solves: over grids of parameters and settings, and from many guesses."""

from ocp.sweeps.sweep import sweep

__all__ = ["sweep"]
