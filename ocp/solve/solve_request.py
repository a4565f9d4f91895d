"""Request of a solve by names and numbers, from which any process can build the solve's session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ocp import plugins
from ocp.errors import InputError, did_you_mean
from ocp.routes.session import Session
from ocp.solve.request import SOLVE_SETTINGS, ProblemSource
from ocp.solve.solve import new_session
from ocp.store.provenance import check_content, content_digest
from ocp.transcription.factories import DEFAULT_LAW, law_digest, law_settings

NAME_PREFIXES = {"contact": "contact_settings", "problem": "params", "setting": "settings"}
"""Mapping from prefixes of full names, such as ``contact.mu``, to fields of a request."""


@dataclass(frozen=True)
class SolveRequest:
    """Request of ``ocp solve``: a problem's name or file, and names and settings of law, method, policy and solver.

    ``settings`` are the settings that ``-s`` accepts: those of the method and of the solver, and
    ``policy.<name>``. ``content`` is the digest of the user's files that define the problem and a learned law,
    or None if unknown. Any process that builds the request checks that the files it reads have the same digest.
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

    def with_content(self, source: ProblemSource) -> SolveRequest:
        """Return the request with the digest of the user's files from which ``source`` was read."""
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

    def at(self, values: Mapping[str, float]) -> SolveRequest:
        """Return the request with changed ``values``, a mapping from full names (:meth:`full_name`) to numbers."""
        changes: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            field_name, key = _field_and_key(name)
            entries = changes.setdefault(field_name, dict(getattr(self, field_name)))
            entries[key] = int(value) if float(value).is_integer() else value
        return replace(self, **changes)

    def sets(self, name: str) -> bool:
        """Return whether the request sets a value for the full name ``name``."""
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
        command = ["ocp", "solve", self.problem]
        for option, settings in (("-p", self.params), ("-c", self.contact_settings), ("-s", self.settings)):
            command += [part for key, value in settings.items() for part in (option, f"{key}={value}")]
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
            command += [] if value == default else [f"--{name}", str(value)]
        return command


def _field_and_key(name: str) -> tuple[str, str]:
    """Return the field of :class:`SolveRequest` that stores a full name, and the key in that field."""
    head, _, key = name.partition(".")
    return ("settings", name) if head == "policy" else (NAME_PREFIXES[head], key)
