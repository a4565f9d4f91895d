"""A scalar task that can be computed by hand: x+ = 0.9 x + 0.5 u, with a contact far away."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dynamics.contact import Exact
from dynamics.systems import Parameter, ParameterTable, Signal, lcs
from ocp.learning.experiment import Experiment
from ocp.problem.task import Measure, Task

A, B, FAR = 0.9, 0.5, 1e3


def scalar(horizon: int = 2, done: float | None = None, broken: float | None = None, width: float = 0.25) -> Task:
    """Return the task with reward -(x+ - 1)² - 0.1 u² and start 0.5 + ``width`` chance, ended where x > ``done``.

    The reward is NaN where x+ exceeds ``broken``.
    """
    p = ParameterTable([Parameter("goal", 1.0, "1", "where to go")])
    system = lcs("scalar", A=[[A]], B=[[B]], C=[[1.0]], D=[[1.0]], E=[[B]], F=[[1.0]], d=[FAR], parameters=p)
    chance = ca.SX.sym("chance")
    x_next, u = system.x_next, system.u
    reward = -((x_next - p["goal"]) ** 2) - 0.1 * u**2
    if broken is not None:
        reward += 1e-3 * ca.log(broken - x_next)
    return Task(
        name="scalar",
        system=system,
        parameters=p,
        horizon=horizon,
        start=0.5 + width * chance,
        chance=chance,
        reward=reward,
        observation=system.x,
        observations=(Signal("x", "1"),),
        lower=np.array([-2.0]),
        upper=np.array([2.0]),
        done=0.0 if done is None else system.x > done,
        measures=(Measure(Signal("mean", "1"), x_next),),
    )


def experiment(algorithm: Any, **given: Any) -> Experiment:
    """Return a small experiment on the scalar task under the exact law, with one thread."""
    settings = {"task": scalar(), "law": Exact(), "iterations": 3, "threads": 1, "episodes": 4}
    return Experiment(algorithm=algorithm, **{**settings, **given})
