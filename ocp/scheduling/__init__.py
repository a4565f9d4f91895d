"""Many jobs side by side: here, over processes of this computer, or over a Dask cluster."""

from ocp.scheduling.jobs import Failure, Function, Heard, Tell, in_turn
from ocp.scheduling.side_by_side import carried_out

__all__ = ["Failure", "Function", "Heard", "Tell", "carried_out", "in_turn"]
