"""``ocp.gradient_report``: whether gradients of a scene, a file or a function are right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from typing import Any

import numpy as np

from ocp import plugins
from ocp.errors import InputError
from ocp.gradients.worlds.report import GradientReport, Question, ReportSettings, measure_worlds
from ocp.gradients.worlds.world import Simulation, World
from ocp.solution import Solution


def gradient_report(
    source: str | PathLike[str] | Solution | Simulation,
    worlds: Sequence[str] = (),
    *,
    theta: Sequence[float] | float | None = None,
    gradient: Simulation | None = None,
    truth: Simulation | None = None,
    size: float | None = None,
    settings: Mapping[str, float] | None = None,
    **options: Any,
) -> GradientReport:
    """Judge whether the gradients of simulators are right, as ``ocp gradients`` does::

        gradient_report("oblique-drop", ["exact", "mujoco"]).sentences
        gradient_report(rollout, theta=[0.5], truth=closed_form).rows[0]["verdict"]

    ``source`` is the name of a scene, the path of a file that defines ``rollout(theta)``, a solution, whose cost is
    judged along directions of its inputs, or that function: from parameters (n, d) to outputs (n, m). A function needs
    the nominal parameters ``theta`` (d,); optional are its ``gradient``, from (n, d) to (n, m, d), the exact outputs
    ``truth``, from (n, d) to (n, m), and the ``size`` of the first parameter, by default its absolute value. The report
    is on the derivative of the first output by the first parameter. ``worlds`` are names of simulators or files, and
    ``settings`` values of their settings. ``options`` are those of :class:`ReportSettings`.

    Raises :class:`~ocp.errors.InputError` for unknown names, and for simulators of wrong shape or without a seed.
    """
    report_settings = ReportSettings(**options)
    if not callable(source):
        if theta is not None or gradient is not None or truth is not None or size is not None:
            raise InputError("theta, gradient, truth and size are for a function; a file defines them itself")
        named = source if isinstance(source, Solution) else fspath(source)
        case = plugins.problems.gradient_case(named, worlds, settings, report_settings.seed)
        return measure_worlds(case.worlds, case.questions, report_settings)
    if theta is None or worlds:
        raise InputError("a function needs theta, its nominal parameters, and is compared with no other simulators")
    nominal = np.atleast_1d(np.asarray(theta, dtype=float))
    scale = abs(float(nominal[0])) if size is None else size
    if not scale > 0:
        raise InputError(f"the size of the parameter must be > 0, got {scale:g}; set size")
    world = World(getattr(source, "__name__", "rollout"), source, gradient, settings or {})
    exact_world = None if truth is None else World("truth", truth)
    return measure_worlds([world], Question(nominal, scale, exact_world), report_settings)
