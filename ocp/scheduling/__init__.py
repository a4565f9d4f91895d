"""Many jobs side by side: here, over processes of this computer, or over a Dask cluster."""

from ocp.scheduling.jobs import Failure, Function, Heard, Tell, carried_out, in_turn

__all__ = ["Failure", "Function", "Heard", "Tell", "carried_out", "in_turn"]
