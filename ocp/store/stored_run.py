"""A stored run read back: arrays, and the records that its description holds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.errors import DamagedRun, InputError
from ocp.judges.findings import Audit, Refereed
from ocp.physics.contact_book import ContactSummary
from ocp.physics.measures import Violation, Worst
from ocp.problem import Problem
from ocp.programs.status import Status
from ocp.rollout import Gains
from ocp.solution import Solution, StageRecord
from ocp.stationarity.certificate import Certificate, Move
from ocp.store.plain import number, read

if TYPE_CHECKING:
    import xarray as xr

DATA_FILE, META_FILE = "solution.nc", "meta.json"


@dataclass(frozen=True)
class StoredRun:
    """A run read back: labelled arrays, and everything else as plain JSON values.

    ``meta`` holds ``schema kind problem created argv versions revision seed hash checksum`` and,
    for ``kind == "solve"``, ``record audit certificate referee idle_cost cost status verdict grade
    stages iterations build_s solve_s others``.
    """

    path: Path
    data: xr.Dataset
    meta: dict[str, Any]

    @property
    def kind(self) -> str:
        """What made it: ``solve``, ``continue``, ..."""
        return self.meta["kind"]

    @property
    def record(self) -> dict[str, Any]:
        """What was asked."""
        return self.meta.get("record") or {}

    @cached_property
    def status(self) -> Status:
        """Outcome of the solve; raises as :attr:`audit` does."""
        with self._described():
            return next(s for s in Status if s.label == self.meta["status"])

    @cached_property
    def audit(self) -> Audit:
        """Audit of the solve; numbers that were not finite are NaN.

        Raises :class:`~ocp.errors.DamagedRun` where ``meta.json`` lacks a part of it.
        """
        with self._described():
            found = self.meta["audit"]
            worst = [Violation(**item) for item in found["worst"]]
            contacts = [read(ContactSummary, item) for item in found["contacts"]]
            lists = {"worst": worst, "contacts": contacts}
            return read(Audit, {**found, **lists})

    @cached_property
    def certificate(self) -> Certificate:
        """Certificate of the solve; raises as :attr:`audit` does."""
        with self._described():
            found = self.meta["certificate"]
            return read(Certificate, {**found, "moves": [Move(**item) for item in found["moves"]]})

    @cached_property
    def referee(self) -> Refereed:
        """What the referee found; raises as :attr:`audit` does."""
        with self._described():
            found = self.meta["referee"]
            lengths = {
                field.name: Worst(**found[field.name]) if found[field.name] else None
                for field in fields(Refereed)
                if "Worst" in str(field.type)
            }
            broken = [Violation(**item) for item in found["broken"]]
            return read(Refereed, {**found, **lengths, "broken": broken})

    @cached_property
    def stages(self) -> list[StageRecord]:
        """Homotopy table of the solve; raises as :attr:`audit` does."""
        with self._described():
            return [read(StageRecord, stage) for stage in self.meta["stages"]]

    def solution(self, problem: Problem) -> Solution:
        """Return the solution as it was solved, of ``problem`` built again at its parameters.

        Its ``values`` are the problem's alone: a replay takes the knobs of the law it is given.

        Raises :class:`~ocp.errors.DamagedRun` where ``meta.json`` lacks a part of it, and
        :class:`~ocp.errors.InputError` for a run that is no solve.
        """
        if self.kind != "solve":
            raise InputError(f"{self.path} holds a {self.kind} study, expected a run of ocp solve")
        meta, data = self.meta, self.data
        with self._described():
            return Solution(
                data=data,
                cost=number(meta["cost"]),
                status=self.status,
                audit=self.audit,
                certificate=self.certificate,
                referee=self.referee,
                idle_cost=number(meta["idle_cost"]),
                stages=self.stages,
                iterations=meta["iterations"],
                build_s=number(meta["build_s"]),
                solve_s=number(meta["solve_s"]),
                record=self.record,
                problem=problem,
                values=problem.parameters.defaults,
                gains=Gains(data["K"].values, data["k"].values) if "K" in data else None,
                others=meta["others"],
                evaluation_s=number(meta.get("evaluation_s")),
            )  # fmt: skip

    @contextmanager
    def _described(self) -> Iterator[None]:
        try:
            yield
        except (KeyError, TypeError, StopIteration) as error:
            raise DamagedRun(
                f"{self.path / META_FILE}: the solution's description is incomplete ({error!r})"
            ) from error
