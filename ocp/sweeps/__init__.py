"""Many solves: over grids of parameters, knobs and settings, and from many guesses."""

from ocp.sweeps.sweep import sweep

__all__ = ["sweep"]
