"""Physical parameters of a system learned from transitions."""

from ocp.learning.identification.identify import Identification, Intervals, identify, intervals
from ocp.learning.identification.one_step import OneStepLoss
from ocp.learning.identification.random_search import RandomSearch

__all__ = [
    "Identification",
    "Intervals",
    "OneStepLoss",
    "RandomSearch",
    "identify",
    "intervals",
]
