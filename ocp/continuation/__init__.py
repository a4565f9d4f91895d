"""A solution followed along a parameter, with what happens on the way."""

from ocp.continuation.walk import Continuation, CurvePoint, continue_over, curve_dataset, resolve

__all__ = ["Continuation", "CurvePoint", "continue_over", "curve_dataset", "resolve"]
