"""One solve in plain words, so that any process can build it, and the same at other values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ocp.errors import InputError, did_you_mean
from ocp.factories import law_settings
from ocp.plugins import load_plugin
from ocp.request import ProblemSource
from ocp.session import Session
from ocp.settings import OWN
from ocp.solve import new_session
from ocp.store.provenance import content_digest

_PLACES = {"contact": "contact_settings", "problem": "params", "setting": "settings"}
"""Fields that hold what a name with such a beginning means."""


class FilesChanged(InputError):
    """Files are no longer what a study was asked of; the message names them."""


@dataclass(frozen=True)
class Case:
    """What ``ocp solve`` is told: a named problem or a file, and names and settings of the rest.

    ``settings`` are those of ``-s``: the method's, the solver's, and ``policy.<name>``. ``content``
    is the digest of the user's files that it was asked of, the problem's and a learned law's, where
    that is known: any process that builds it sees to it that they are the same there.
    """

    problem: str
    params: Mapping[str, Any] = field(default_factory=dict)
    contact: str = "barrier"
    contact_settings: Mapping[str, Any] = field(default_factory=dict)
    method: str = "direct"
    policy: str = "open-loop"
    solver: str = "ipopt"
    settings: Mapping[str, Any] = field(default_factory=dict)
    content: str | None = None

    def source(self) -> ProblemSource:
        """What builds the problem.

        Raises :class:`~ocp.errors.InputError` for an unknown name, and :class:`FilesChanged` where
        files have changed since the request.
        """
        found = load_plugin("problems").source(self.problem)
        if self.content not in (None, self._content(found)):
            raise FilesChanged(
                f"{self.problem}, what it imports, or a file of the law has changed since this was"
                " begun, so that two problems would mix; give the same command again"
            )
        return found

    def with_content(self, source: ProblemSource) -> Case:
        """The same, asked of the user's files as ``source`` was read from them."""
        return replace(self, content=self._content(source))

    def _content(self, source: ProblemSource) -> str:
        return content_digest(getattr(source, "digest", None), self.contact_settings)

    def session(self, source: ProblemSource | None = None) -> Session:
        """Build it, of ``source`` where that is at hand.

        Raises :class:`~ocp.errors.InputError` as :func:`~ocp.solve.new_session` does, and for names
        and settings that there are not.
        """
        return new_session(
            source or self.source(), self.contact, self.method, self.policy, self.solver,
            self.settings, params=self.params, contact_settings=self.contact_settings,
        )  # fmt: skip

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
        for option, held in (("-p", self.params), ("-c", self.contact_settings),
                             ("-s", self.settings)):  # fmt: skip
            words += [part for key, value in held.items() for part in (option, f"{key}={value}")]
        chosen = {"contact": (self.contact, "barrier"), "method": (self.method, "direct"),
                  "policy": (self.policy, "open-loop"), "solver": (self.solver, "ipopt"),
                  "seed": (seed, 0), "starts": (starts, 1), "rank": (rank, "planned")}  # fmt: skip
        for name, (value, usual) in chosen.items():
            words += [] if value == usual else [f"--{name}", str(value)]
        return words


def _placed(name: str) -> tuple[str, str]:
    """Field of a :class:`Case` and key there of a full name."""
    head, _, key = name.partition(".")
    return ("settings", name) if head == "policy" else (_PLACES[head], key)
