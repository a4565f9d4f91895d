"""One solution from three judges: of an outcome, and of a solve that was interrupted."""

from ocp.judgement.interruption import keeping
from ocp.judgement.judging import idle_cost, judged, record

__all__ = ["idle_cost", "judged", "keeping", "record"]
