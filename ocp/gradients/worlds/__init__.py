"""Gradients of other people's simulators: measures at many amplitudes, and a verdict with numbers."""

from ocp.gradients.worlds.public import gradient_report
from ocp.gradients.worlds.report import GradientReport, Question, ReportSettings, measure_worlds
from ocp.gradients.worlds.world import World, check_world

__all__ = [
    "GradientReport",
    "Question",
    "ReportSettings",
    "World",
    "check_world",
    "gradient_report",
    "measure_worlds",
]
