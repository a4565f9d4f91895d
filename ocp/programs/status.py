"""How a solve ended."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """Outcome of a solve; the value is the sentence a person reads."""

    SOLVED = "solved: feasible by the audit, and certified stationary"
    NOT_OPTIMAL = "feasible, not optimal"
    UNDECIDED = "feasible, but whether it is optimal was not decided"
    INEXACT = "not solved: the solver stopped, but the audited residuals are above tolerance"
    NO_PROGRESS = (
        "no-progress: it does no better than standing still; start from a smoothing law and"
        " follow it (--contact exact -s homotopy=true)"
    )
    ITERATION_LIMIT = "not converged: the iteration limit was reached"
    TIME_LIMIT = "not converged: it took too long and was given up"
    INFEASIBLE = "not converged: the constraints could not be met from this guess"
    DIVERGED = "not converged: the iterates diverged or a function returned NaN or infinity"
    INTERRUPTED = (
        "interrupted: stopped by the user; this is the best point by then, and --from its run goes"
        " on there"
    )
    FAILED = "not converged: the solver gave up"

    @property
    def label(self) -> str:
        """Short name, as in JSON."""
        return self.name.lower().replace("_", "-")
