"""Verdicts on the gradients of simulators, from secants over many amplitudes and smoothed gradients."""

from ocp.gradients.worlds.report import GradientReport, Measurements, Question, ReportSettings
from ocp.gradients.worlds.world import World, check_world

__all__ = ["GradientReport", "Measurements", "Question", "ReportSettings", "World", "check_world"]
