"""One solve in plain words, so that any process can build it, and its session.

The session of a point is made as that of any solve is, so that its answer is the same to the last
bit: guess, natural units and each decision that looks at a number are its own. What it does not
build again are functions: of programs, steps, costs and bounds. They have all parameters as inputs
and nothing else from outside, so equal graphs make equal functions.
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
from ocp.distribution import load_plugin
from ocp.errors import InputError, did_you_mean
from ocp.problem.problem import Problem
from ocp.routes.session import Session
from ocp.solve.request import OWN, ProblemSource
from ocp.solve.solve import new_session
from ocp.store.provenance import check_content, content_digest
from ocp.transcription.factories import DEFAULT_LAW, law_digest, law_settings

_PLACES = {"contact": "contact_settings", "problem": "params", "setting": "settings"}
"""Fields that hold what a name with such a beginning means."""


@dataclass(frozen=True)
class Case:
    """What ``ocp solve`` is told: a named problem or a file, and names and settings of the rest.

    ``settings`` are those of ``-s``: the method's, the solver's, and ``policy.<name>``. ``content``
    is the digest of the user's files that it was asked of, the problem's and a learned law's, where
    that is known: any process that builds it sees to it that they are the same there.
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
        """What builds the problem.

        Raises :class:`~ocp.errors.InputError` for an unknown name, and
        :class:`~ocp.store.provenance.FilesChanged` where files have changed since the request.
        """
        found = load_plugin("problems").source(self.problem)
        check_content(self.problem, self.content, self._digests(found), self.contact_settings)
        return found

    def with_content(self, source: ProblemSource) -> Case:
        """The same, asked of the user's files as ``source`` was read from them."""
        content = content_digest(self._digests(source), self.contact_settings)
        return replace(self, content=content)

    def _digests(self, source: ProblemSource) -> tuple[str | None, str | None]:
        return getattr(source, "digest", None), law_digest(self.contact)

    def session(self, source: ProblemSource | None = None) -> Session:
        """Build it, of ``source`` where that is at hand.

        Raises :class:`~ocp.errors.InputError` as :func:`~ocp.solve.solve.new_session` does, and for names
        and settings that there are not.
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
        """The same with other values by full name, as :meth:`full_name` gives it."""
        changed: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            place, key = _placed(name)
            held = changed.setdefault(place, dict(getattr(self, place)))
            held[key] = int(value) if float(value).is_integer() else value
        return replace(self, **changed)

    def sets(self, name: str) -> bool:
        """Whether a full name has a value of its own here."""
        place, key = _placed(name)
        return key in getattr(self, place)

    def full_name(self, name: str, source: ProblemSource) -> str:
        """What ``name`` means: ``problem.M``, ``contact.mu``, ``setting.tol``, ``policy.bound``.

        A parameter of the problem, or else a setting of the law, may go without its beginning.

        Raises :class:`~ocp.errors.InputError` with the nearest names for one that is none of them,
        or that takes words.
        """
        params, law = source.Params.model_fields, law_settings(self.contact)
        head, dot, key = name.partition(".")
        if dot and head in (*_PLACES, "policy"):
            full = name
        else:
            full = f"problem.{name}" if name in params or name not in law else f"contact.{name}"
            head, _, key = full.partition(".")
        known = {"problem": tuple(params), "contact": law}.get(head)
        inner = head == "contact" and key.startswith("base.")
        if known is not None and key not in known and not inner:
            whole = [*params, *(f"contact.{one}" for one in law)]
            raise InputError(
                f"--over: there is no parameter {name!r}{did_you_mean(name, whole)};"
                f" {source.name} and the {self.contact} law have {', '.join(whole)}, and"
                " setting.<name> is a number of -s"
            )
        if (head == "problem" and params[key].annotation not in (int, float)) or (
            head == "setting" and key in OWN and key not in ("factor", "start")
        ):
            raise InputError(f"--over: {name} is not a number; a sweep needs numbers")
        return full

    def command(self, seed: int = 0, starts: int = 1, rank: str = "planned") -> list[str]:
        """Words of the ``ocp solve`` that does the same."""
        words = ["ocp", "solve", self.problem]
        for option, held in (("-p", self.params), ("-c", self.contact_settings), ("-s", self.settings)):
            words += [part for key, value in held.items() for part in (option, f"{key}={value}")]
        chosen = {
            "contact": (self.contact, DEFAULT_LAW),
            "method": (self.method, "direct"),
            "policy": (self.policy, "open-loop"),
            "solver": (self.solver, "ipopt"),
            "seed": (seed, 0),
            "starts": (starts, 1),
            "rank": (rank, "planned"),
        }
        for name, (value, usual) in chosen.items():
            words += [] if value == usual else [f"--{name}", str(value)]
        return words


def _placed(name: str) -> tuple[str, str]:
    """Field of a :class:`Case` and key there of a full name."""
    head, _, key = name.partition(".")
    return ("settings", name) if head == "policy" else (_PLACES[head], key)


class SessionCache:
    """The last session of a worker, whose functions the next one takes over where it can."""

    def __init__(self) -> None:
        self._last: tuple[Any, Session] | None = None
        self._sources: dict[tuple[str, str | None], ProblemSource] = {}

    def session(self, case: Case) -> Session:
        """Build a session; raises as :meth:`~ocp.jobs.case.Case.session` does."""
        asked = case.problem, case.content
        if asked not in self._sources:
            self._sources[asked] = case.source()
        made = case.session(self._sources[asked])
        told = [asked, structure(made)]
        if self._last is not None and self._last[0] == told:
            _share_functions(self._last[1], made)
        self._last = told, made
        return made


# Dask may do two jobs in one process, in a thread each.
_of_thread = threading.local()


def cached_session(case: Case) -> Session:
    """Build a session by what this thread has kept; raises as :class:`SessionCache` does."""
    if not hasattr(_of_thread, "kept"):
        _of_thread.kept = SessionCache()
    return _of_thread.kept.session(case)


def structure(session: Session) -> list[Any]:
    """All that a session's functions depend on: graphs, sizes and choices, no parameter's value."""
    problem, step = session.problem, session.step
    steps = (step, problem.exact_step, problem.referee_step)
    return [
        [(type(one), _digest(one.relation)) for one in steps],
        _digest(_costs_and_bounds(problem)),
        step.p.names,
        problem.N,
        problem.scenarios,
        [pair.kind for pair in problem.system.pairs],
        _settings(session.law, step.p),
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
    parts = [(one.expression, one.lower, one.upper) for one in constraints]
    ends = [*problem.limits(p), *problem.start_limits(p)]
    costs = [problem.stage_cost, problem.terminal_cost]
    h = ca.SX(problem.system.h)
    held = [*costs, *ends, *(ca.SX(part) for row in parts for part in row), h]
    return ca.Function("problem", problem.symbols, held)


def _digest(function: ca.Function) -> str:
    return hashlib.sha256(function.serialize().encode()).hexdigest()


def _settings(law: ContactLaw, p: ParameterTable) -> list[Any]:
    """The settings of a law that are no parameters of its graphs."""
    found = [
        (key, _settings(value, p) if isinstance(value, ContactLaw) else value)
        for key, value in law.settings().items()
        if LAW_PREFIX + key not in p
    ]
    return [type(law), *found]


def _share_functions(old: Session, new: Session) -> None:
    for one, other in (
        (old.problem, new.problem),
        (old.step, new.step),
        (old.problem.exact_step, new.problem.exact_step),
        (old.problem.referee_step, new.problem.referee_step),
    ):
        _give_functions(one, other)
    _give_programs(old, new)
    for helper in old.helpers.values():
        other = new.helper(helper.law, helper.method)
        _give_functions(helper.step, other.step)
        _give_programs(helper, other)


def _give_functions(old: Problem | Step, new: Problem | Step) -> None:
    # Where a cached property keeps what it made.
    kept = vars(new)
    for name, value in vars(old).items():
        if isinstance(value, ca.Function):
            kept.setdefault(name, value)


def _give_programs(old: Session, new: Session) -> None:
    new.compiled = old.compiled
    for reformulation, nlp in old.nlps.items():
        taken = replace(nlp, problem=new.problem, step=new.step, policy=new.policy, solvers={})
        # A program's scale is part of its compiled solvers.
        if nlp.scale is None and taken.scale is None:
            taken.solvers.update(nlp.solvers)
        new.nlps[reformulation] = taken
