"""Verdicts on the gradients of simulators, from secants over many amplitudes and smoothed gradients."""

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
