"""Continuation of a solution along a parameter, with the location of events."""

from ocp.continuation.walk import Continuation, CurvePoint, continue_over, curve_dataset, resolve

__all__ = ["Continuation", "CurvePoint", "continue_over", "curve_dataset", "resolve"]
