"""Motions of a run for animations: the plan and its replay under the exact law, with contact forces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from ocp.errors import InputError
from ocp.problem.problem import Problem
from problems.drawing import ContactFrame, Shape
from problems.plugin import spec_of
from reports.drawing.shapes import Camera, make_cameras
from reports.drawing.strobe import Forces, forces_drawn, forces_of
from reports.drawing.view import RunView, with_ghosts

_MOST_FRAMES = 1500
"""Maximum number of frames of an animation."""
_SAME = 2e-4
"""Difference up to which plan and replay count as equal (below a pixel), as a fraction of the largest state."""


@dataclass(frozen=True)
class Motion:
    """States (n, nx), shapes and contacts of n frames, and contact forces (n, points) during each frame.

    A replay that diverges to non-finite states has fewer frames than the animation has times. ``suffix`` is the
    end of the names of the motion's arrays in the run.
    """

    title: str
    suffix: str
    x: np.ndarray
    shapes: list[list[Shape]]
    contacts: list[list[ContactFrame]]
    forces: Forces | None


class Animation:
    """A run sampled at ``times`` [s]: one or two ``motions``, each with a camera."""

    def __init__(self, view: RunView, fps: int = 25, speed: float = 1.0, cones: bool = False) -> None:
        """Sample ``fps`` frames per second; with ``speed`` 0.5, two seconds show one second of motion.

        Raises :class:`~ocp.errors.InputError` for a run without states or a problem without a
        drawing, and for more frames than :data:`_MOST_FRAMES`.
        """
        check_drawable(view)
        assert view.picture is not None
        self.view, self.fps, self.speed, self.cones = view, fps, speed, cones
        self.times = frame_times(float(view.time[-1]), fps, speed)
        self.motions = motions(view, self.times)
        self.cameras: list[Camera] = make_cameras([motion.shapes for motion in self.motions])
        self.axes: tuple[str, str] = view.picture.axes

    @property
    def title(self) -> str:
        """Title of the problem, with the number of the scenario if there are several."""
        scenarios = self.view.run.data.sizes["scenario"]
        noun = "seed" if self.view.run.kind == "closed-loop" else "scenario"
        suffix = f", {noun} 0 of {scenarios}" if scenarios > 1 else ""
        return f"{self.view.title}{suffix}"

    @property
    def largest(self) -> float:
        """Magnitude of the largest force of all motions, 0 without forces."""
        largest_forces = [motion.forces.largest for motion in self.motions if motion.forces]
        return max(largest_forces, default=0.0)

    @property
    def unit(self) -> str:
        """Unit of the forces, "" without forces."""
        return next((motion.forces.unit for motion in self.motions if motion.forces), "")

    @property
    def rough(self) -> bool:
        """Whether friction cones are shown."""
        friction = (contact.friction for motion in self.motions for contact in motion.contacts[0])
        return self.cones and any(friction)

    def clock(self, frame: int) -> str:
        """Return the time of a frame, and the speed if it is not real time."""
        pace = "" if self.speed == 1 else f"   {self.speed:g} × real time"
        return f"t = {self.times[frame]:.2f} s{pace}"


def frame_times(duration: float, fps: int, speed: float) -> np.ndarray:
    """Return evenly spaced times of frames from 0 to ``duration`` [s], about ``speed / fps`` apart.

    Raises :class:`~ocp.errors.InputError` for more frames than :data:`_MOST_FRAMES`.
    """
    steps = max(1.0, duration * fps / speed)
    if steps > _MOST_FRAMES:
        raise InputError(
            f"{duration:.4g} s at {fps} frames per second and speed {speed:g} need {steps:.0f}"
            f" frames, at most {_MOST_FRAMES} are allowed; raise --speed or lower --fps"
        )
    return np.linspace(0.0, duration, round(steps) + 1)


def motions(view: RunView, times: np.ndarray) -> list[Motion]:
    """Return the plan and its exact replay at ``times`` [s]; only the plan if both agree or there is no replay."""
    law = view.run.record.get("contact", "chosen")
    title = f"planned under the {law} law"
    if view.run.kind == "train":
        title = f"the policy of {view.run.record['algorithm']} under the exact law"
    if view.run.kind == "closed-loop":
        record = view.run.record
        title = f"phase {record['phase']}, plant {record['plant']}; pale: the end of the plan"
        loop = _motion(view, "", title, times)
        return [replace(loop, shapes=with_ghosts(view, times, loop.shapes))]
    plan = _motion(view, "", title, times)
    x, x_replay = view.array("x"), view.array("x_replay")
    assert x is not None
    if x_replay is None:
        return [plan]
    largest_difference = float(np.max(np.abs(x[0] - x_replay[0])))
    if largest_difference <= _SAME * max(1.0, float(np.max(np.abs(x[0])))):
        agreement = f"the replay under the exact law agrees (states within {largest_difference:.0e})"
        return [replace(plan, title=f"{plan.title}; {agreement}")]
    return [plan, _motion(view, "_replay", "replayed under the exact law", times)]


def _motion(view: RunView, suffix: str, title: str, times: np.ndarray) -> Motion:
    picture, x = view.picture, view.array(f"x{suffix}")
    assert picture is not None and x is not None
    states = np.stack([np.interp(times, view.time, column) for column in x[0].T], axis=1)
    finite = np.isfinite(states).all(axis=1)
    if not finite.all():
        end = max(1, int(np.argmin(finite)))
        states = states[:end]
        title = f"{title}; diverges at {times[end]:.2f} s"
    shown_times = times[: len(states)]
    contacts = picture.contacts(suffix, shown_times)
    forces = forces_drawn(forces_of(view, suffix), contacts)
    return Motion(
        title,
        suffix,
        states,
        picture.shapes(suffix, shown_times),
        contacts,
        None if forces is None else _sampled(forces, view.time, times),
    )


def _sampled(forces: Forces, nodes: np.ndarray, times: np.ndarray) -> Forces:
    """Return forces at frames: the forces of the step before the nearest node, zero before the first step.

    If steps are shorter than frames, the forces are means over the steps since the last frame.
    """
    nearest = np.abs(times[:, None] - nodes).argmin(axis=1)
    count = max(1, round((times[1] - times[0]) / (nodes[1] - nodes[0])))

    def mean(values: np.ndarray) -> np.ndarray:
        at_nodes = np.concatenate([np.zeros_like(values[:1]), values])
        return np.stack([at_nodes[max(0, k - count + 1) : k + 1].mean(axis=0) for k in nearest])

    return replace(forces, normal=mean(forces.normal), friction=mean(forces.friction))


def is_periodic(view: RunView) -> bool:
    """Return whether the problem requires some states at the end of a motion to equal those at its start."""
    start = view.problem.start if isinstance(view.problem, Problem) else None
    return start is not None and bool(start.periodic)


def repeated(view: RunView, count: int) -> RunView:
    """Return ``count`` strides of a periodic run, each starting at the end of the previous one.

    From one stride to the next, states increase by their change over a stride (zero for periodic states), and
    times increase by the duration of a stride; impulses repeat.
    """
    data = view.run.data.reset_coords()
    nodes = data[[name for name in data if "node" in data[name].dims]]
    gained = nodes.isel(node=-1) - nodes.isel(node=0)
    strides = [nodes.isel(node=slice(bool(k), None)) + k * gained for k in range(count)]
    pushes = data[[name for name in data if "interval" in data[name].dims]]
    repeated_data = xr.merge([xr.concat(strides, "node"), xr.concat([pushes] * count, "interval")])
    run = view.run.with_data(repeated_data.set_coords("time"))
    if view.spec is None:
        return replace(view, run=run)
    title = f"{view.spec.title}, the stride {count} times"
    return replace(view, run=run, spec=replace(view.spec, title=title))


def check_drawable(view: RunView) -> None:
    """Raise :class:`~ocp.errors.InputError` for a run without motion or without a drawing."""
    name = view.run.meta["problem"]
    if view.run.kind not in ("solve", "train", "closed-loop") or view.array("x") is None:
        raise InputError(
            f"{view.run.path} is a run of ocp {view.run.kind}, which has no motion; give a run of"
            " ocp solve, ocp train or ocp mpc"
        )
    if view.picture is not None:
        return
    if view.spec is None:
        if stored := view.run.own_problem:
            raise InputError(f"the problem {name!r} has no drawing: {stored['undrawn']}")
        spec_of(view.run)
        raise InputError(f"the problem {name!r} of {view.run.path} no longer fits the run")
    if view.spec.draw is None:
        raise InputError(
            f"the problem {name!r} has no drawing; add draw(params, state) -> list of shapes"
            " (problems.drawing) to its file"
        )
