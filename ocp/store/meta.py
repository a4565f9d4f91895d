"""Descriptions of runs: types of the entries of ``meta.json`` for each kind of run, and their checks."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict

from ocp.errors import DamagedRun, InputError
from ocp.judge.audit import Audit
from ocp.judge.certificate import Certificate
from ocp.judge.referee import RefereeReport
from ocp.judge.verdict import Grade
from ocp.programs.solver import Status
from ocp.routes.homotopy import StageRecord
from ocp.store.json_values import from_json
from ocp.store.run_files import DATA_FILE, MAX_BYTES, META_FILE

Scalar = str | float | bool
Values = dict[str, Scalar | list[Scalar]]
Row = dict[str, Any]


class Record(TypedDict, total=False):
    """Record of a run's request; each kind of run has some of these entries."""

    params: Values
    contact: str
    contact_settings: Values
    law_settings: list[str]
    method: str
    policy: str
    policy_settings: Values
    solver: str
    solver_options: Values
    strategy: str | None
    jit: str | None
    law_parameters: dict[str, float]
    N: float
    learned_at: dict[str, Any]
    seed: int | None
    versions: dict[str, str]
    citation: str
    source: str | None
    algorithm: str
    algorithm_settings: dict[str, Any]


class RunMeta(TypedDict):
    """Entries of ``meta.json`` that every run has."""

    schema: int
    kind: str
    problem: str
    created: str
    hash: str
    versions: dict[str, str]
    revision: str | None
    tags: list[str]
    parts: dict[str, str]
    record: Record
    argv: list[str]
    status: str
    verdict: str


class OptionalMeta(TypedDict, total=False):
    """Entries of ``meta.json`` that only some runs have; ``source_digest`` covers a user's file and its imports."""

    seed: int | None
    source_digest: str | None
    grade: Grade | None
    cost: float
    over: str
    stage_cost: float
    terminal_cost: float
    planned: float
    violated: list[Row]


class SolveMeta(TypedDict):
    """Further entries of ``meta.json`` for a run of ``ocp solve``."""

    status: Status
    grade: Grade
    audit: Audit
    certificate: Certificate
    referee: RefereeReport
    stages: list[StageRecord]
    others: list[Row]
    cost: float
    idle_cost: float
    iterations: int
    build_s: float
    solve_s: float
    evaluation_s: float


class ContinueRow(TypedDict):
    """Entry of ``meta.json`` for one point of a run of ``ocp continue``, which follows a solution over a parameter."""

    value: float
    status: str
    success: bool
    cost: float
    exact_cost: float
    referee_cost: float
    survives: bool | None
    stationarity: str
    iterations: int
    complementarity: float


Ends = TypedDict("Ends", {"from": float, "to": float})


class ContinueMeta(Ends):
    """Further entries of ``meta.json`` for a run of ``ocp continue``."""

    over: str
    steps: int
    scale: Literal["log", "linear"]
    unit: str
    points: list[ContinueRow]
    events: list[Row]
    iterations: int
    nlp_builds: int
    success: bool


class SweepAxis(TypedDict):
    """Entry of ``meta.json`` for an axis of a sweep."""

    name: str
    full_name: str
    values: list[float]
    log: bool
    units: str


class SweepGrid(TypedDict):
    """Entry of ``meta.json`` for the grid of a sweep and its failed points."""

    axes: list[SweepAxis]
    shape: list[int]
    failed: list[Row]


class SweepMeta(TypedDict):
    """Further entries of ``meta.json`` for a run of ``ocp sweep``."""

    study: SweepGrid
    solved: int
    points: int
    survives: int
    success: bool


class EstimateMeta(TypedDict):
    """Further entries of ``meta.json`` for a run of ``ocp estimate``."""

    sweep: Row | None
    estimates: list[Row]


class GradientsMeta(TypedDict):
    """Additional entries of ``meta.json`` for a run of ``ocp gradients``; ``worlds`` has an item per simulator."""

    title: str
    parameter: Row
    output: Row
    worlds: list[Row]


class TrainMeta(TypedDict):
    """Further entries of ``meta.json`` for a run of ``ocp train``."""

    evaluation: dict[str, float]
    untrained: dict[str, float]
    last: dict[str, float]
    best_iteration: int
    env_steps: float
    wall_s: float


class FigureMeta(TypedDict):
    """Further entries of ``meta.json`` for a run of ``ocp figure``."""

    claims: list[Row]


class ClosedLoopMeta(TypedDict):
    """Further entries of ``meta.json`` for a run of ``ocp mpc``; ``costs`` and ``ended`` have one item per seed."""

    costs: list[float]
    cost_interval: list[float]
    ended: list[int]
    survived: float
    diverged: int
    seconds: dict[str, float]
    statuses: dict[str, int]
    misses: int
    counts: NotRequired[dict[str, dict[str, int]]]
    certified: float
    note_counts: dict[str, int]
    notes: list[str]


class ParameterMeaning(TypedDict):
    """Entry of ``problem.json`` for a parameter: its unit and description."""

    unit: str
    description: str


class MotionRecord(TypedDict):
    """Entry of ``problem.json`` for a motion: shapes and contacts to draw at each node."""

    shapes: list[list[Row]]
    contacts: list[list[Row]]


class OwnProblem(TypedDict):
    """Entries of ``problem.json``, the description of a user's problem, to show a run when its file is missing."""

    title: str
    equations: list[str]
    axes: list[str]
    parameters: dict[str, ParameterMeaning]
    motions: dict[str, MotionRecord]
    undrawn: str


META_TYPES: dict[str, Any] = {
    "solve": SolveMeta,
    "continue": ContinueMeta,
    "sweep": SweepMeta,
    "estimate": EstimateMeta,
    "gradients": GradientsMeta,
    "train": TrainMeta,
    "figure": FigureMeta,
    "closed-loop": ClosedLoopMeta,
}
"""Mapping from kinds of runs to the types of their further entries in ``meta.json``."""


def check_meta(file: Path, meta: dict[str, Any]) -> None:
    """Raise :class:`~ocp.errors.DamagedRun` if an entry of the description ``meta`` is missing or invalid."""
    try:
        from_json(RunMeta, meta)
        from_json(OptionalMeta, meta)
        _check_parts(meta["parts"])
        _check_time(meta["created"])
        if meta["kind"] not in META_TYPES:
            raise ValueError(f"kind is {meta['kind']!r}, expected one of {', '.join(META_TYPES)}")
        from_json(META_TYPES[meta["kind"]], meta)
    except ValueError as error:
        raise DamagedRun(f"{file} does not describe a run: {error}") from error


def check_own_problem(file: Path, description: dict[str, Any]) -> None:
    """Raise :class:`~ocp.errors.DamagedRun` unless ``description`` is an :class:`OwnProblem`."""
    try:
        from_json(OwnProblem, description)
        if len(description["axes"]) != len("xy"):
            raise ValueError(f"axes are {len(description['axes'])}, expected 2")
    except ValueError as error:
        raise DamagedRun(f"{file} does not describe a problem: {error}") from error


def _check_parts(parts: dict[str, str]) -> None:
    allowed = set(MAX_BYTES) - {META_FILE}
    if unknown := sorted(set(parts) - allowed):
        raise ValueError(f"parts names {unknown[0]!r}, expected one of {', '.join(sorted(allowed))}")
    if DATA_FILE not in parts:
        raise ValueError(f"parts lacks {DATA_FILE}")


def _check_time(created: str) -> None:
    with suppress(ValueError):
        if datetime.fromisoformat(created).tzinfo is not None:
            return
    raise ValueError(f"created is {created!r}, expected a time with its zone")


def check_tags(tags: Iterable[str]) -> list[str]:
    """Return ``tags`` sorted and without duplicates.

    Raises :class:`~ocp.errors.InputError` for a tag that is not one word of letters, digits, ``_ . -``.
    """
    for tag in tags:
        if not re.fullmatch(r"[\w.-]{1,60}", tag):
            raise InputError(f"a tag is one word of letters, digits, _ . - and at most 60 of them, got {tag!r}")
    return sorted(set(tags))
