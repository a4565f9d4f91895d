"""Continuation of a solution along a parameter, with the location of events."""

from ocp.continuation.curve import Continuation, CurvePoint, curve_dataset
from ocp.continuation.walk import continue_over, resolve

__all__ = ["Continuation", "CurvePoint", "continue_over", "curve_dataset", "resolve"]
