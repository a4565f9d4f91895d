"""One solution from three judges: of an outcome, and of a solve that was interrupted."""

from ocp.judgement.interruption import keeping
from ocp.judgement.judging import idle_cost, judged, record
from ocp.judgement.refinement import halved, refined

__all__ = ["halved", "idle_cost", "judged", "keeping", "record", "refined"]
