"""A stored run beside its problem or task, which is found again by name or by its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.systems import Signal
from ocp.errors import InputError
from ocp.problem import Problem
from ocp.store.stored_run import StoredRun
from ocp.task import Task
from problems import ProblemSpec
from problems.lent import known_parameters, problem_of
from problems.tasks import registry as tasks
from problems.tasks.spec import TaskSpec
from reports.picture import Picture, picture_of

if TYPE_CHECKING:
    import xarray as xr


def task_of(run: StoredRun) -> tuple[TaskSpec, Any, Task]:
    """Build the task of a training again; raises as :func:`~problems.lent.problem_of` does."""
    found = tasks.spec(str(run.meta["problem"]))
    params = found.params(known_parameters(run, found))
    return found, params, found.build(params)


@dataclass(frozen=True)
class RunView:
    """What pages and figures show of a run; ``spec`` and ``params`` are None if not found again."""

    run: StoredRun
    spec: ProblemSpec | TaskSpec | None
    params: Any
    problem: Problem | Task | None

    @classmethod
    def of(cls, run: StoredRun, own: ProblemSpec | None = None) -> RunView:
        """Look at a run; a problem that cannot be built again is left out.

        ``own`` is the problem in a file that a person named (:func:`~problems.lent.spec_of`).
        """
        try:
            return cls(run, *(task_of(run) if run.kind == "train" else problem_of(run, own)))
        except InputError:
            return cls(run, None, None, None)

    @property
    def title(self) -> str:
        """Title of the problem."""
        if self.spec is not None:
            return self.spec.title
        told = self.run.own_problem
        return str(self.run.meta["problem"]) if told is None else str(told["title"])

    @cached_property
    def picture(self) -> Picture | None:
        """What is drawn of it, None for a run without states or drawing."""
        return picture_of(self)

    @property
    def pictured(self) -> int:
        """How many scenarios can be drawn: a run keeps the drawing of the first alone."""
        return self.scenarios if self.spec is not None else 1

    def signals(self, kind: str) -> list[Signal]:
        """Names and units of the ``states``, ``inputs`` or ``contacts``."""
        if self.problem is not None:
            return list(getattr(self.problem.system, kind))
        dimension = {"states": "state", "inputs": "control", "contacts": "contact"}[kind]
        names, unit = self.run.data[dimension].values, f"{dimension}_unit"
        units = self.run.data[unit].values if unit in self.run.data else [""] * len(names)
        return [Signal(str(name), str(one)) for name, one in zip(names, units, strict=True)]

    @property
    def gap_unit(self) -> str:
        """Unit of the gaps."""
        if self.problem is not None:
            return self.problem.system.gap_unit
        return str(self.run.data["gap"].attrs.get("units", "m")) if "gap" in self.run.data else "m"

    def array(self, name: str) -> np.ndarray | None:
        """Values of a stored array, or None where the run has none, as forces of a learned law."""
        found = self.run.data.get(name)
        return found.values if found is not None and found.size else None

    @property
    def time(self) -> np.ndarray:
        """Time of each node [s], shape (N+1,)."""
        return np.asarray(self.run.data["time"].values, dtype=float)

    @property
    def scenarios(self) -> int:
        """Number of scenarios."""
        return int(self.run.data.sizes.get("scenario", 1))

    def scenario(self, index: int) -> RunView:
        """The same run with one of its scenarios alone."""
        return self._of(self.run.data.isel(scenario=[index]))

    def along(self, point: int) -> RunView:
        """One point of a path: its trajectories, and the problem at its parameters."""
        name, data = str(self.run.meta["over"]), self.run.data
        seen = self._of(data.isel(point=point))
        if not isinstance(self.spec, ProblemSpec) or name not in self.spec.Params.model_fields:
            return seen
        params = self.params.model_copy(update={name: float(data["value"].values[point])})
        return replace(seen, params=params, problem=self.spec.build(params))

    def _of(self, data: xr.Dataset) -> RunView:
        return replace(self, run=replace(self.run, data=data))
