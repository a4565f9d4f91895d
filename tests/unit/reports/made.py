"""Synthetic runs, for tests of pictures without a solve."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from ocp.labelled import LabelledArrays
from ocp.store.stored_run import StoredRun
from problems.drawing import ContactFrame, Rectangle, Shape, Wall
from problems.parameters import Parameters
from problems.spec import ProblemSpec
from reports.drawing.view import RunView

FRICTION = 0.5


def draw(params: object, state: np.ndarray) -> list[Shape]:
    return [Wall(0, 0, 0, 1), Rectangle(float(state[0]), 0.1, 0.4, 0.2, rounding=0.05)]


def frames(params: object, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of a heel and a toe on the floor."""
    x = float(state[0])
    return [ContactFrame(x - 0.15, 0, 0, 1, FRICTION), ContactFrame(x + 0.15, 0, 0, 1, FRICTION)]


def sliding_box(
    normal: np.ndarray,
    friction: np.ndarray,
    *,
    x: np.ndarray | None = None,
    x_replay: np.ndarray | None = None,
    h: float = 0.1,
) -> RunView:
    """Return a run of a box on a floor with impulses (N, 2) at heel and toe, half as large in the replay."""
    N = len(normal)
    x = np.linspace(0, 0.5, N + 1) if x is None else x
    again = x + 0.1 if x_replay is None else x_replay
    contact, point = ("scenario", "interval", "contact"), ("scenario", "interval", "point")
    data = xr.Dataset(
        {
            "x": (("scenario", "node", "state"), x[None, :, None]),
            "x_replay": (("scenario", "node", "state"), again[None, :, None]),
            "lam": (contact, normal[None]),
            "lam_replay": (contact, normal[None] / 2),
            "normal_impulse": (point, normal[None]),
            "friction_impulse": (point, friction[None]),
            "normal_impulse_replay": (point, normal[None] / 2),
            "friction_impulse_replay": (point, friction[None] / 2),
        },
        coords={
            "time": ("node", h * np.arange(N + 1)),
            "state": ["x"],
            "contact": ["heel", "toe"],
            "point": ["heel", "toe"],
        },
    )
    meta = {"kind": "solve", "problem": "box", "record": {"contact": "barrier"}}
    spec = ProblemSpec(
        name="box", title="A box that slides", Params=Parameters, build=_unbuilt, draw=draw, frames=frames
    )
    return RunView(StoredRun(Path("runs/box"), LabelledArrays.of(data), meta), spec, None, None)


def _unbuilt(params: object):
    raise AssertionError("a picture builds no problem")
