"""A solution followed along a parameter, with what happens on the way."""

from ocp.continuation.walk import Continuation, PathPoint, continue_over, path_dataset, resolve

__all__ = ["Continuation", "PathPoint", "continue_over", "path_dataset", "resolve"]
