"""Specifications of named problems: parameters, builder, drawing, known optima."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from dynamics.learned.region import Region
from dynamics.settings import Setting, parse_number, settings_of
from ocp.errors import InputError, did_you_mean
from ocp.problem.checks import check_physics
from ocp.problem.parts import Origin
from ocp.problem.problem import Problem
from ocp.validation import Count, Index, Line, Number, Positive
from problems.drawing import STORED_KINDS, ContactFrame, Shape
from problems.parameters import natural_units
from problems.user_code import guarded, user_code

S = TypeVar("S", bound="Spec")
MOST_NODES = 20_000
"""Maximum number of nodes, over all motions, for which a run stores drawings."""


@dataclass(frozen=True)
class Citation:
    """Source of a problem: its key in the bibliography, and a text with the section or equation."""

    key: Line
    text: Line


@dataclass(frozen=True)
class Golden:
    """Best known cost of a problem at its default parameters, under the contact law ``law``.

    Solving with ``settings`` from guess ``start`` (0 is the problem's guess, k is the k-th perturbed guess
    with seed 0, see :mod:`ocp.problem.rollout`) ends at ``cost``, within the relative ``tolerance``,
    with the ``stationarity`` and ``kind`` of certificate (:mod:`ocp.judge.certificate`). ``tried``
    is the number of solves, over strategies and guesses; no certified solve ended at a lower cost.

    ``independent`` is a confirmation by other software or a formula, "" if there is none; ``note``
    describes other minima, and the result of the default settings if it differs.
    """

    cost: Number
    law: Line = "exact"
    method: Line = "direct"
    stationarity: Line = "B"
    kind: Line = "S"
    settings: Mapping[str, str | float] = field(default_factory=dict)
    start: Index = 0
    tried: Count = 1
    independent: Line = ""
    note: Line = ""
    tolerance: Positive = 1e-6

    @property
    def certificate(self) -> str:
        """Stationarity and kind in the wording of ``ocp solve``."""
        return ", ".join(kind_name for kind_name in (self.stationarity, self.kind) if kind_name)

    @property
    def remarks(self) -> str:
        """Remarks on one line: options of ``ocp solve`` that are not defaults, the confirmation, and the note."""
        options = [f"-s {name}={value}" for name, value in self.settings.items()]
        options += [f"--starts {self.start + 1}"] if self.start else []
        command = f"found with {' '.join(options)}" if options else ""
        confirmed = f"confirmed by {self.independent}" if self.independent else ""
        return "; ".join(remark for remark in (command, confirmed, self.note) if remark)


def smoothed(cost: float, **more: Any) -> Golden:
    """Return the best known cost under the barrier law, whose certificate is KKT and has no kind."""
    return Golden(cost, law="barrier", stationarity="KKT", kind="", **more)


@dataclass(frozen=True, kw_only=True)
class Spec:
    """Specification of a problem or an objective: name, parameters, equations in typst notation, and source."""

    name: str
    title: str
    Params: type[BaseModel]
    equations: tuple[str, ...] = ()
    citation: Citation | None = None

    def params(self, values: Mapping[str, Any]) -> Any:
        """Return the checked ``values`` with defaults for missing parameters.

        Raises :class:`~ocp.errors.InputError` with the parameter, its unit and its range in its message.
        """
        return check_parameters(self.name, self.Params, values)


@dataclass(frozen=True, kw_only=True)
class ProblemSpec(Spec):
    """Specification of a named problem, which can be built at any parameter values.

    ``build(params)`` returns the :class:`~ocp.problem.problem.Problem`, ``draw(params, state)`` the
    shapes at one state (nx,), ``frames(params, state)`` the point and direction of each contact,
    ``region(params)`` the region from which transitions are sampled (None: see
    :mod:`problems.regions`). ``axes`` are labels of the drawing, ``path`` is the user's file (None if
    the problem ships with the workbench), and ``digest`` its :func:`problems.source_digest.source_digest`.
    """

    build: Callable[[Any], Problem]
    draw: Callable[[Any, np.ndarray], list[Shape]] | None = None
    frames: Callable[[Any, np.ndarray], list[ContactFrame]] | None = None
    axes: tuple[str, str] = ("x [m]", "y [m]")
    region: Callable[[Any], Region] | None = None
    golden: Mapping[str, Golden] = field(default_factory=dict)
    path: Path | None = None
    digest: str | None = None

    def params(self, values: Mapping[str, Any]) -> Any:
        """Return the checked ``values`` with defaults for missing parameters; raises as :meth:`Spec.params` does."""
        if self.path is None:
            return super().params(values)
        with user_code("Params failed:", self.path, through=InputError):
            return super().params(values)

    def problem(self, values: Mapping[str, Any] | None = None) -> Problem:
        """Build the problem at ``values`` and the defaults of the other parameters.

        Raises :class:`~ocp.errors.InputError` for a bad parameter, and if a user's ``build`` raises
        or returns no problem, a problem with inconsistent dimensions, or a problem without physical meaning, for
        example without mass.
        """
        params = self.params(values or {})
        problem = self.build(params)
        if not isinstance(problem, Problem):
            kind = "nothing" if problem is None else f"a {type(problem).__name__}"
            raise InputError(
                f"{self.path or self.name}: build(params) returned {kind}, expected an ocp.problem.Problem"
            )
        check_physics(problem)
        guess = problem.guess
        if guess is not None and self.path is not None:
            guess = guarded(guess, "guess(problem, p)", self.path)
        symbols, values_by_name = problem.parameters.names, params.model_dump()
        fixed = {name: value for name, value in values_by_name.items() if name not in symbols}
        return replace(
            problem,
            guess=guess,
            scaling=replace(problem.scaling, units=natural_units(params, problem)),
            origin=Origin(
                settings={**fixed, **problem.origin.settings},
                citation=problem.origin.citation or (self.citation.key if self.citation else ""),
                source=None if self.path is None else str(self.path),
                source_digest=self.digest,
                record=None if self.path is None else UserProblemRecord(self, params),
            ),
        )


@dataclass(frozen=True)
class UserProblemRecord:
    """Description of a user's problem at its parameters, which its runs store instead of the file's code."""

    spec: ProblemSpec
    params: Any

    def describe_motions(self, motions: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Return title, equations, parameters, and the drawings at the states (n, nx) of each motion.

        The format is :class:`ocp.store.meta.OwnProblem`. Drawings of a motion end before its first state
        that is not finite. ``undrawn`` is the reason why there are no drawings, "" if there are drawings.
        """
        spec = self.spec
        record = {
            "title": spec.title,
            "equations": list(spec.equations),
            "axes": list(spec.axes),
            "parameters": {
                name: {"unit": about.unit, "description": about.meaning}
                for name, about in settings_of(spec.Params).items()
            },
            "motions": {},
            "undrawn": "",
        }
        if spec.draw is None:
            return {**record, "undrawn": "its file has no draw(params, state)"}
        if sum(map(len, motions.values())) > MOST_NODES:
            return {**record, "undrawn": f"its motion has more than {MOST_NODES} nodes"}
        try:
            return {**record, "motions": {key: self._motion_record(x) for key, x in motions.items()}}
        except InputError as error:
            return {**record, "undrawn": str(error)}

    def _motion_record(self, x: np.ndarray) -> dict[str, Any]:
        spec, finite = self.spec, np.isfinite(x).all(axis=1)
        assert spec.draw is not None
        finite_states = x if finite.all() else x[: max(1, int(np.argmin(finite)))]
        shapes = [spec.draw(self.params, state) for state in finite_states]
        names_by_kind = {kind: kind_name for kind_name, kind in STORED_KINDS.items()}
        contacts = [] if spec.frames is None else [spec.frames(self.params, s) for s in finite_states]
        return {
            "shapes": [[{"kind": names_by_kind[type(s)], **asdict(s)} for s in node] for node in shapes],
            "contacts": [[asdict(contact) for contact in node] for node in contacts],
        }


def check_parameters(owner: str, Params: type[BaseModel], values: Mapping[str, Any]) -> Any:
    """Return ``values`` checked against ``Params``, with defaults for missing parameters.

    Raises :class:`~ocp.errors.InputError` with ``owner``, the parameter, its unit and its range in its message.
    """
    checked = dict(values)
    settings = settings_of(Params)
    for name, parameter in settings.items():
        if name not in checked:
            continue
        try:
            checked[name] = parse_number(checked[name], parameter.annotation)
        except ValueError:
            raise InputError(f"{owner}: {_range_message(parameter, checked[name])}") from None
    try:
        return Params(**checked)
    except ValidationError as error:
        raise InputError(f"{owner}: {_validation_message(settings, error, values)}") from None


def _validation_message(settings: Mapping[str, Setting], error: ValidationError, values: Mapping[str, Any]) -> str:
    details = error.errors()[0]
    if not details["loc"]:
        return details["msg"].removeprefix("Value error, ")
    name = str(details["loc"][0])
    if name not in settings:
        return f"unknown parameter {name!r}{did_you_mean(name, settings)}; it takes {', '.join(settings) or 'none'}"
    if details["type"] == "missing":
        return f"parameter {name} has no default; give {settings[name].range}"
    return _range_message(settings[name], values.get(name, details["input"]))


def _range_message(parameter: Setting, value: Any) -> str:
    meaning = f" ({parameter.meaning})" if parameter.meaning else ""
    return parameter.message(f"parameter {parameter.name}{meaning}", value)


def describe(spec: Spec) -> list[dict[str, Any]]:
    """Return a list of the parameters in order, each with name, value, unit, range and description."""
    return [
        {
            "name": about.name,
            "value": about.default,
            "unit": about.unit,
            "range": about.range,
            "description": about.meaning,
        }
        for about in settings_of(spec.Params).values()
    ]


def spec_from_module(kind: type[S], module: ModuleType, **more: Any) -> S:
    """Return the specification whose fields are the names defined in ``module``, and ``more``.

    Each line of the text ``equations`` is one equation; a line that begins with a space continues
    the previous line.
    """
    names = (field.name for field in fields(kind) if field.name not in more)
    values = {name: getattr(module, name) for name in names if hasattr(module, name)}
    text = re.sub(r"\n +", " ", values.get("equations", "").strip())
    return kind(**{**values, **more, "equations": tuple(text.splitlines())})
