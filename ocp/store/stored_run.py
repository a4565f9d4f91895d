"""A stored run read back: arrays, and the records that its description holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.errors import DamagedRun, InputError
from ocp.judges.audit import Audit
from ocp.judges.referee import RefereeReport
from ocp.problem import Problem
from ocp.programs.solver import Status
from ocp.rollout import Gains
from ocp.solution import Solution, StageRecord
from ocp.stationarity.certificate import Certificate
from ocp.store.json_values import from_json
from ocp.store.meta import check_own_problem
from ocp.store.run_files import META_FILE, PROBLEM_FILE, parsed

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class StoredRun:
    """A run read back: labelled arrays, and everything else as plain JSON values.

    ``parts`` are its other files, in bytes, by name.
    ``meta`` holds ``schema kind problem created argv versions revision seed hash parts checksum``,
    of types that :mod:`ocp.store.meta` tells, and
    for ``kind == "solve"``, ``record audit certificate referee idle_cost cost status verdict grade
    stages iterations build_s solve_s others``.
    """

    path: Path
    data: xr.Dataset
    meta: dict[str, Any]
    parts: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """What made it: ``solve``, ``continue``, ..."""
        return self.meta["kind"]

    @property
    def record(self) -> dict[str, Any]:
        """What was asked."""
        return self.meta.get("record") or {}

    @cached_property
    def own_problem(self) -> dict[str, Any] | None:
        """What it keeps of a problem of a user's file (:class:`~ocp.store.meta.OwnProblem`).

        None where it keeps nothing; raises as :attr:`audit` does.
        """
        if PROBLEM_FILE not in self.parts:
            return None
        file = self.path / PROBLEM_FILE
        told = parsed(file, self.parts[PROBLEM_FILE])
        check_own_problem(file, told)
        return told

    @cached_property
    def status(self) -> Status:
        """Outcome of the solve; raises as :attr:`audit` does."""
        return self._described(Status, "status")

    @cached_property
    def audit(self) -> Audit:
        """Audit of the solve; numbers that were not finite are NaN.

        Raises :class:`~ocp.errors.DamagedRun` where ``meta.json`` lacks a part of it.
        """
        return self._described(Audit, "audit")

    @cached_property
    def certificate(self) -> Certificate:
        """Certificate of the solve; raises as :attr:`audit` does."""
        return self._described(Certificate, "certificate")

    @cached_property
    def referee(self) -> RefereeReport:
        """What the referee found; raises as :attr:`audit` does."""
        return self._described(RefereeReport, "referee")

    @cached_property
    def stages(self) -> list[StageRecord]:
        """Homotopy table of the solve; raises as :attr:`audit` does."""
        return self._described(list[StageRecord], "stages")

    def solution(self, problem: Problem) -> Solution:
        """Return the solution as it was solved, of ``problem`` built again at its parameters.

        Its ``values`` are the problem's alone: a replay takes the parameters of its own law.

        Raises :class:`~ocp.errors.DamagedRun` where ``meta.json`` lacks a part of it, and
        :class:`~ocp.errors.InputError` for a run that is no solve.
        """
        if self.kind != "solve":
            hint = "; ocp evaluate judges a policy" if self.kind == "train" else ""
            raise InputError(
                f"{self.path} holds a {self.kind} study, expected a run of ocp solve{hint}"
            )
        data, numbers = self.data, ("cost", "idle_cost", "build_s", "solve_s", "evaluation_s")
        kept = ("status", "audit", "certificate", "referee", "stages", "record")
        return Solution(
            data=data,
            iterations=self._described(int, "iterations"),
            problem=problem,
            values=problem.parameters.defaults,
            gains=Gains(data["K"].values, data["k"].values) if "K" in data else None,
            others=self._described(list, "others"),
            **{name: getattr(self, name) for name in kept},
            **{name: self._described(float, name) for name in numbers},
        )

    def _described(self, kind: Any, key: str) -> Any:
        try:
            return from_json(kind, self.meta[key])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DamagedRun(
                f"{self.path / META_FILE}: the solution's description is incomplete ({error!r})"
            ) from error
