"""Description of a solve by names and numbers, from which any process can build the solve's session.

The session of a sweep's point is built like the session of a single solve, so that both have bitwise the same
solution. Only compiled functions (of programs, steps, costs and bounds) are reused between points. Parameters
are inputs of these functions, so that points that differ in parameters alone share them.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import casadi as ca

from dynamics.contact import ContactLaw, Step
from dynamics.systems import LAW_PREFIX, ParameterTable
from ocp import plugins
from ocp.errors import InputError, did_you_mean
from ocp.problem.problem import Problem
from ocp.routes.session import Session
from ocp.solve.request import SOLVE_SETTINGS, ProblemSource
from ocp.solve.solve import new_session
from ocp.store.provenance import check_content, content_digest
from ocp.transcription.factories import DEFAULT_LAW, law_digest, law_settings

NAME_PREFIXES = {"contact": "contact_settings", "problem": "params", "setting": "settings"}
"""Mapping from prefixes of full names, such as ``contact.mu``, to fields of a case."""


@dataclass(frozen=True)
class Case:
    """Request of ``ocp solve``: a problem's name or file, and names and settings of law, method, policy and solver.

    ``settings`` are the settings that ``-s`` accepts: those of the method and of the solver, and
    ``policy.<name>``. ``content`` is the digest of the user's files that define the problem and a learned law,
    or None if unknown. Any process that builds the case checks that the files it reads have the same digest.
    """

    problem: str
    params: Mapping[str, Any] = field(default_factory=dict)
    contact: str = DEFAULT_LAW
    contact_settings: Mapping[str, Any] = field(default_factory=dict)
    method: str = "direct"
    policy: str = "open-loop"
    solver: str = "ipopt"
    settings: Mapping[str, Any] = field(default_factory=dict)
    content: str | None = None

    def source(self) -> ProblemSource:
        """Return the source that builds the problem.

        Raises :class:`~ocp.errors.InputError` for an unknown name, and
        :class:`~ocp.store.provenance.FilesChanged` if files have changed since the request.
        """
        source = plugins.problems.source(self.problem)
        check_content(self.problem, self.content, self._digests(source), self.contact_settings)
        return source

    def with_content(self, source: ProblemSource) -> Case:
        """Return the case with the digest of the user's files from which ``source`` was read."""
        content = content_digest(self._digests(source), self.contact_settings)
        return replace(self, content=content)

    def _digests(self, source: ProblemSource) -> tuple[str | None, str | None]:
        return getattr(source, "digest", None), law_digest(self.contact)

    def session(self, source: ProblemSource | None = None) -> Session:
        """Build the session of the solve; ``source``, if given, builds the problem.

        Raises the errors of :func:`~ocp.solve.solve.new_session`, and :class:`~ocp.errors.InputError` for
        unknown names and settings.
        """
        return new_session(
            source or self.source(),
            self.contact,
            self.method,
            self.policy,
            self.solver,
            self.settings,
            params=self.params,
            contact_settings=self.contact_settings,
        )

    def at(self, values: Mapping[str, float]) -> Case:
        """Return the case with changed ``values``, a mapping from full names (:meth:`full_name`) to numbers."""
        changes: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            field_name, key = _field_and_key(name)
            entries = changes.setdefault(field_name, dict(getattr(self, field_name)))
            entries[key] = int(value) if float(value).is_integer() else value
        return replace(self, **changes)

    def sets(self, name: str) -> bool:
        """Return whether the case sets a value for the full name ``name``."""
        field_name, key = _field_and_key(name)
        return key in getattr(self, field_name)

    def full_name(self, name: str, source: ProblemSource) -> str:
        """Return the full name of ``name``, such as ``problem.M``, ``contact.mu``, ``setting.tol``, ``policy.bound``.

        A ``name`` without prefix is a parameter of the problem or else a setting of the law.

        Raises :class:`~ocp.errors.InputError` for an unknown name (the message suggests similar names) and for
        a setting that is not a number.
        """
        params, law = source.Params.model_fields, law_settings(self.contact)
        prefix, dot, key = name.partition(".")
        if dot and prefix in (*NAME_PREFIXES, "policy"):
            full_name = name
        else:
            full_name = f"problem.{name}" if name in params or name not in law else f"contact.{name}"
            prefix, _, key = full_name.partition(".")
        allowed = {"problem": tuple(params), "contact": law}.get(prefix)
        is_base_setting = prefix == "contact" and key.startswith("base.")
        if allowed is not None and key not in allowed and not is_base_setting:
            choices = [*params, *(f"contact.{setting}" for setting in law)]
            raise InputError(
                f"--over: there is no parameter {name!r}{did_you_mean(name, choices)};"
                f" {source.name} and the {self.contact} law have {', '.join(choices)}, and"
                " setting.<name> is a number of -s"
            )
        if (prefix == "problem" and params[key].annotation not in (int, float)) or (
            prefix == "setting" and key in SOLVE_SETTINGS and SOLVE_SETTINGS[key].kind != "number"
        ):
            raise InputError(f"--over: {name} is not a number; a sweep needs numbers")
        return full_name

    def command(self, seed: int = 0, starts: int = 1, rank: str = "planned") -> list[str]:
        """Return the words of the equivalent ``ocp solve`` command."""
        words = ["ocp", "solve", self.problem]
        for option, settings in (("-p", self.params), ("-c", self.contact_settings), ("-s", self.settings)):
            words += [word for key, value in settings.items() for word in (option, f"{key}={value}")]
        options = {
            "contact": (self.contact, DEFAULT_LAW),
            "method": (self.method, "direct"),
            "policy": (self.policy, "open-loop"),
            "solver": (self.solver, "ipopt"),
            "seed": (seed, 0),
            "starts": (starts, 1),
            "rank": (rank, "planned"),
        }
        for name, (value, default) in options.items():
            words += [] if value == default else [f"--{name}", str(value)]
        return words


def _field_and_key(name: str) -> tuple[str, str]:
    """Return the field of :class:`Case` that stores a full name, and the key in that field."""
    head, _, key = name.partition(".")
    return ("settings", name) if head == "policy" else (NAME_PREFIXES[head], key)


class SessionCache:
    """Cache of a worker's last session, whose compiled functions the next session reuses if possible."""

    def __init__(self) -> None:
        self._last: tuple[Any, Session] | None = None
        self._sources: dict[tuple[str, str | None], ProblemSource] = {}

    def session(self, case: Case) -> Session:
        """Build a session of ``case`` and cache it; raises the errors of :meth:`~ocp.jobs.case.Case.session`."""
        request = case.problem, case.content
        if request not in self._sources:
            self._sources[request] = case.source()
        session = case.session(self._sources[request])
        identity = [request, structure(session)]
        if self._last is not None and self._last[0] == identity:
            _share_functions(self._last[1], session)
        self._last = identity, session
        return session


# The state is local to a thread, since Dask may run two jobs in one process, each in its own thread.
_thread_state = threading.local()


def cached_session(case: Case) -> Session:
    """Build a session of ``case`` with this thread's cache; raises the errors of :class:`SessionCache`."""
    if not hasattr(_thread_state, "cache"):
        _thread_state.cache = SessionCache()
    return _thread_state.cache.session(case)


def structure(session: Session) -> list[Any]:
    """Return everything on which a session's compiled functions depend: graphs, sizes and choices, no parameters."""
    problem, step = session.problem, session.step
    steps = (step, problem.exact_step, problem.referee_step)
    return [
        [(type(graph), _digest(graph.relation)) for graph in steps],
        _digest(_costs_and_bounds(problem)),
        step.p.names,
        problem.N,
        problem.scenarios,
        [pair.kind for pair in problem.system.pairs],
        _fixed_settings(session.law, step.p),
        session.method.name,
        session.policy.name,
        asdict(session.policy),
        session.solver.name,
        session.solver.options,
        session.strategy,
        session.homotopy,
        session.factor,
        session.homotopy_start,
        session.compiled is None,
    ]


def _costs_and_bounds(problem: Problem) -> ca.Function:
    p = problem.parameters.vector
    constraints = [*problem.path, *problem.terminal]
    bounded = [(constraint.expression, constraint.lower, constraint.upper) for constraint in constraints]
    limits = [*problem.limits(p), *problem.start_limits(p)]
    costs = [problem.stage_cost, problem.terminal_cost]
    h = ca.SX(problem.system.h)
    outputs = [*costs, *limits, *(ca.SX(expression) for row in bounded for expression in row), h]
    return ca.Function("problem", problem.symbols, outputs)


def _digest(function: ca.Function) -> str:
    return hashlib.sha256(function.serialize().encode()).hexdigest()


def _fixed_settings(law: ContactLaw, p: ParameterTable) -> list[Any]:
    """Return a law's type, and the settings of the law that are not parameters of its graphs."""
    fixed = [
        (key, _fixed_settings(value, p) if isinstance(value, ContactLaw) else value)
        for key, value in law.settings().items()
        if LAW_PREFIX + key not in p
    ]
    return [type(law), *fixed]


def _share_functions(old: Session, new: Session) -> None:
    for old_owner, new_owner in (
        (old.problem, new.problem),
        (old.step, new.step),
        (old.problem.exact_step, new.problem.exact_step),
        (old.problem.referee_step, new.problem.referee_step),
    ):
        _copy_functions(old_owner, new_owner)
    _copy_programs(old, new)
    for old_session in old.sub_sessions.values():
        new_owner = new.sub_session(old_session.law, old_session.method)
        _copy_functions(old_session.step, new_owner.step)
        _copy_programs(old_session, new_owner)


def _copy_functions(old: Problem | Step, new: Problem | Step) -> None:
    # The instance's dictionary contains the values of cached properties.
    cached = vars(new)
    for name, value in vars(old).items():
        if isinstance(value, ca.Function):
            cached.setdefault(name, value)


def _copy_programs(old: Session, new: Session) -> None:
    new.compiled = old.compiled
    for reformulation, nlp in old.nlps.items():
        program = replace(nlp, problem=new.problem, step=new.step, policy=new.policy, solvers={})
        # A program's scale is part of its compiled solvers.
        if nlp.scale is None and program.scale is None:
            program.solvers.update(nlp.solvers)
        new.nlps[reformulation] = program
