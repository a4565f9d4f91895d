"""A stored run with its problem or task, and its pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from dynamics.systems import Signal
from ocp.errors import DamagedRun, InputError
from ocp.problem.problem import Problem
from ocp.store.stored_run import StoredRun
from problems import ProblemSpec
from problems.drawing import STORED_KINDS, ContactFrame, Shape
from problems.plugin import known_parameters, problem_of

if TYPE_CHECKING:
    import xarray as xr

    from ocp.problem.task import Task
    from problems.tasks.registry import TaskSpec


def task_of(run: StoredRun) -> tuple[TaskSpec, Any, Task]:
    """Return spec, parameters and task of a training run; raises the errors of :func:`~problems.plugin.problem_of`."""
    from problems.tasks import registry

    task_spec = registry.spec(str(run.meta["problem"]))
    params = task_spec.params(known_parameters(run, task_spec))
    return task_spec, params, task_spec.build(params)


@dataclass(frozen=True)
class RunView:
    """Stored run for pages and figures; ``spec``, ``params`` and ``problem`` are None for an unknown problem."""

    run: StoredRun
    spec: ProblemSpec | TaskSpec | None
    params: Any
    problem: Problem | Task | None

    @classmethod
    def of(cls, run: StoredRun, file_spec: ProblemSpec | None = None) -> RunView:
        """Return the view of a run; a problem that cannot be built counts as unknown.

        ``file_spec`` is the problem of a user's file (:func:`~problems.plugin.spec_of`).
        """
        if run.kind == "closed-loop":
            # Cut after the last node that any seed reached.
            longest_seed = max(1, int(run.data["ended"].max()))
            data = run.data.isel(node=slice(0, longest_seed + 1), sample=slice(0, longest_seed))
            run = run.with_data(data.rename(_SOLVE_NAMES))
        try:
            return cls(run, *(task_of(run) if run.kind == "train" else problem_of(run, file_spec)))
        except InputError:
            return cls(run, None, None, None)

    @property
    def title(self) -> str:
        """Title of the problem, or its name if the title is unknown."""
        if self.spec is not None:
            return self.spec.title
        stored = self.run.own_problem
        return str(self.run.meta["problem"]) if stored is None else str(stored["title"])

    @cached_property
    def picture(self) -> RunPicture | None:
        """Drawing of the run; None for a run without states or without a drawing."""
        if self.array("x") is None:
            return None
        if self.spec is not None:
            return None if self.spec.draw is None else _picture_of_spec(self, self.spec)
        stored = self.run.own_problem
        return _stored_picture(self, stored) if stored and stored["motions"] else None

    @property
    def pictured(self) -> int:
        """Number of scenarios that can be drawn; 1 for an unknown problem, whose run stores a single drawing."""
        return self.scenarios if self.spec is not None else 1

    def signals(self, kind: str) -> list[Signal]:
        """Return names and units of the ``states``, ``inputs`` or ``contacts``."""
        if self.problem is not None:
            return list(getattr(self.problem.system, kind))
        dimension = {"states": "state", "inputs": "control", "contacts": "contact"}[kind]
        names, unit = self.run.data[dimension].values, f"{dimension}_unit"
        units = self.run.data[unit].values if unit in self.run.data else [""] * len(names)
        return [Signal(str(name), str(signal_unit)) for name, signal_unit in zip(names, units, strict=True)]

    @property
    def gap_unit(self) -> str:
        """Unit of the gaps."""
        if self.problem is not None:
            return self.problem.system.gap_unit
        return str(self.run.data["gap"].attrs.get("units", "m")) if "gap" in self.run.data else "m"

    def array(self, name: str) -> np.ndarray | None:
        """Return the values of a stored array, or None if the run does not have it.

        Coordinates are not arrays here, since a swept parameter may have the name of an array.
        """
        variable = self.run.data.data_vars.get(name)
        return variable.values if variable is not None and variable.size else None

    @property
    def time(self) -> np.ndarray:
        """Time of each node [s], shape (N+1,)."""
        return np.asarray(self.run.data["time"].values, dtype=float)

    @property
    def scenarios(self) -> int:
        """Number of scenarios."""
        return int(self.run.data.sizes.get("scenario", 1))

    def scenario(self, index: int) -> RunView:
        """Return the view of one scenario."""
        return self._of(self.run.data.isel(scenario=[index]))

    def at_point(self, point: int) -> RunView:
        """Return the view of one point of a path, with the problem at the parameters of this point."""
        name, data = str(self.run.meta["over"]), self.run.data
        point_view = self._of(data.isel(point=point))
        if not isinstance(self.spec, ProblemSpec) or name not in self.spec.Params.model_fields:
            return point_view
        params = self.params.model_copy(update={name: float(data["value"].values[point])})
        return replace(point_view, params=params, problem=self.spec.build(params))

    def _of(self, data: xr.Dataset) -> RunView:
        return replace(self, run=self.run.with_data(data))


_SOLVE_NAMES = {"seed": "scenario", "sample": "interval", "input": "control", "input_unit": "control_unit"}
"""Mapping from the dimensions of a closed loop to their names in a solve."""


T = TypeVar("T", Shape, ContactFrame)


@dataclass(frozen=True)
class RunPicture:
    """Drawing of scenario 0 at any times [s], of the plan or, with a suffix, of its replay.

    ``shapes`` and ``contacts`` map a suffix and times to one list per time, which is empty if nothing is known.
    ``axes`` are the labels of the axes; ``framed`` is true if the problem has contact frames.
    """

    axes: tuple[str, str]
    framed: bool
    shapes: Callable[[str, np.ndarray], list[list[Shape]]]
    contacts: Callable[[str, np.ndarray], list[list[ContactFrame]]]


def _picture_of_spec(view: RunView, spec: ProblemSpec | TaskSpec) -> RunPicture:
    """Return the picture that a problem's functions draw at linearly interpolated states."""

    def at(function: Any, suffix: str, times: np.ndarray) -> list[list[Any]]:
        x = view.array(f"x{suffix}")
        if function is None or x is None:
            return [[] for _ in times]
        states = np.stack([np.interp(times, view.time, component) for component in x[0].T], axis=1)
        return [function(view.params, state) for state in states]

    framed = spec.frames is not None
    return RunPicture(spec.axes, framed, partial(at, spec.draw), partial(at, spec.frames))


def _stored_picture(view: RunView, stored: dict[str, Any]) -> RunPicture:
    """Return the picture that a run stores at its nodes, linearly interpolated between them.

    Raises :class:`~ocp.errors.DamagedRun` for an invalid drawing.
    """
    try:
        motions = {suffix: _read(motion) for suffix, motion in stored["motions"].items()}
    except (KeyError, TypeError) as error:
        raise DamagedRun(f"{view.run.path} has a drawing with unknown shapes ({error})") from error

    def at(content: int, suffix: str, times: np.ndarray) -> list[list[Any]]:
        frames: list[list[Any]] = motions[suffix][content]
        if not frames:
            return [[] for _ in times]
        fractional_nodes = np.interp(times, view.time[: len(frames)], np.arange(len(frames)))
        return [_between(frames, float(node)) for node in fractional_nodes]

    framed = any(contacts for _, contacts in motions.values())
    axes = (stored["axes"][0], stored["axes"][1])
    return RunPicture(axes, framed, partial(at, 0), partial(at, 1))


def _read(motion: dict[str, Any]) -> tuple[list[list[Shape]], list[list[ContactFrame]]]:
    """Return shapes and contact frames at each node of a stored motion."""
    shapes = [
        [STORED_KINDS[shape["kind"]](**{k: v for k, v in shape.items() if k != "kind"}) for shape in node_shapes]
        for node_shapes in motion["shapes"]
    ]
    return shapes, [[ContactFrame(**contact) for contact in node_shapes] for node_shapes in motion["contacts"]]


def _between(frames: list[list[T]], node: float) -> list[T]:
    """Return shapes interpolated between two nodes, or the shapes of the nearer node if they do not match.

    Shapes do not match if their kinds change; in a picture of space they never match, since their order may change.
    """
    frame_before, frame_after = frames[int(node)], frames[min(int(node) + 1, len(frames) - 1)]
    changes = [type(shape) for shape in frame_before] != [type(shape) for shape in frame_after]
    if changes or any(getattr(shape, "shade", 0.0) for shape in frame_before):
        return frames[round(node)]
    share = node % 1.0
    return [_mixed(*pair, share) for pair in zip(frame_before, frame_after, strict=True)] if share else frame_before


def _mixed(first: T, second: T, share: float) -> T:
    numbers = [f.name for f in fields(first) if isinstance(getattr(first, f.name), int | float)]
    return replace(first, **{key: (1 - share) * getattr(first, key) + share * getattr(second, key) for key in numbers})


def plan_shapes(view: RunView, sample: int, node: int, body: Sequence[Shape]) -> list[Shape]:
    """Return the shapes at a node of a sample's plan (seed 0), except shapes that are also in ``body``.

    The list is empty if the problem has no drawing, or the sample has no plan.
    """
    spec, plan = view.spec, view.array("plan")
    if not isinstance(spec, ProblemSpec) or spec.draw is None or plan is None:
        return []
    state = plan[0, min(sample, plan.shape[1] - 1), node]
    if not np.isfinite(state).all():
        return []
    return [replace(shape, role="plan") for shape in spec.draw(view.params, state) if shape not in body]


def with_ghosts(view: RunView, times: np.ndarray, shapes: Sequence[list[Shape]]) -> list[list[Shape]]:
    """Return the shapes of each frame at ``times`` [s], preceded by the shapes at the end of the sample's plan."""
    samples = np.searchsorted(view.time, times + 1e-9 * view.time[-1], side="right") - 1
    return [[*plan_shapes(view, int(sample), -1, body), *body] for sample, body in zip(samples, shapes, strict=False)]
