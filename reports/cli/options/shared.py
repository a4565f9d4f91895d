"""Options that several commands share, and functions that declare an option."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, dataclass_transform

import typer

from dynamics.limits import INDEX, STARTS, WORKERS
from reports.cli.streams import Output

if TYPE_CHECKING:
    from dynamics.settings import Range
    from ocp.store.stored_run import StoredRun
    from problems.spec import ProblemSpec

RUN_HELP = "A run: its path, part of its name, or @last, @2, ... from the latest back."
"""Help text of arguments for a run."""
PROBLEM_HELP = "Registered name or path/to/file.py."
"""Help text of arguments for a problem."""
LAW_HELP = "Contact law: a name of ocp settings laws, or path/to/file.py."
"""Help text of options for a contact law."""


def option(default: Any, *flags: str, limits: Range | None = None, **typer_options: Any) -> Any:
    """Declare a field as an option with keywords of ``typer.Option``; the default ``MISSING`` makes it required.

    The flag is ``--`` followed by the field's name, unless ``flags`` contains another long flag. The parser rejects
    numbers outside ``limits``, as :func:`dynamics.settings.read_value` does.
    """
    metadata = {"make": typer.Option, "flags": flags, "limits": limits or {}, **typer_options}
    return field(default=default, metadata=metadata)


def assignment(*flags: str, help: str) -> Any:
    """Declare a field as an option that accepts ``K=V`` and may be repeated."""
    return option(None, *flags, metavar="K=V", help=help)


def argument(default: Any = MISSING, **typer_options: Any) -> Any:
    """Declare a field as a positional argument, with keywords of ``typer.Argument``."""
    return field(default=default, metadata={"make": typer.Argument, "flags": (), "limits": {}, **typer_options})


def decode_utf8(word: str) -> str:
    """Return a word decoded as UTF-8, even if an ASCII locale passed its bytes as lone surrogates.

    Raises ``UnicodeError`` for invalid UTF-8.
    """
    return word.encode("utf-8", "surrogateescape").decode("utf-8")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(option, assignment, argument, field))
class Options:
    """Base class of the options of a command; ``explicit`` contains the names of options on the command line.

    ``code`` is the module of the command. Its function ``check(options)`` raises
    :class:`~ocp.errors.InputError` or a related error before any work, and ``run(options, checked)`` returns
    the exit code. If ``code`` is ``"module:name"``, these functions are called ``check_name`` and ``run_name``.
    The help consists of the class's docstring, ``examples`` (written without ``ocp``), and ``epilog()``.
    """

    code: ClassVar[str]
    examples: ClassVar[tuple[str, ...]]
    as_json: bool = option(False, "--json", help="Print one JSON document on stdout.")
    quiet: bool = option(False, "-q", help="No progress and no tables.")
    verbose: int = option(0, "-v", count=True, show_default=False, help="Log to stderr; -vv for all details.")
    debug: bool = option(False, help="Show the traceback of an error.")
    explicit: frozenset[str] = frozenset()

    def __init_subclass__(cls) -> None:
        # Methods that nothing calls would take half the time: there are forty such classes.
        dataclass(frozen=True, kw_only=True, eq=False, repr=False)(cls)

    @classmethod
    def epilog(cls) -> str:
        """Return the help text below the examples."""
        return ""

    def check(self) -> None:
        """Raise InputError for values that are invalid for every command with these options."""

    @property
    def output(self) -> Output:
        """Streams for results and progress."""
        return Output(self.as_json, self.quiet, self.verbose > 0)

    @property
    def argv(self) -> list[str]:
        """Words of the command line, for the record of a run."""
        return ["ocp", *map(decode_utf8, sys.argv[1:])]

    @property
    def named_runs(self) -> list[str]:
        """Runs that the command reads, as typed by the user."""
        named = getattr(self, "runs", [getattr(self, "run", None)])
        return [run for run in named if run is not None]


class StoreOptions(Options):
    """Option for the directory of the run store."""

    out: Path = option(Path("runs"), envvar="OCP_RUNS", help="Directory of the run store.")

    def stored(self, run: str) -> StoredRun:
        """Return the run with the given name; raises the errors of ``store.find_run`` and ``store.load``."""
        from ocp import store

        return store.load(store.find_run(run, self.out))


class RunOptions(StoreOptions):
    """Argument of commands that read one stored run."""

    run: str = argument(help=RUN_HELP)


class SourceOptions(StoreOptions):
    """Option for the file that defines a run's problem; a file named only in the run is never loaded."""

    source: str | None = option(None, "--source", metavar="FILE", help="File that defines the problem of the run.")

    def problem_from_source(self, runs: Sequence[StoredRun]) -> ProblemSpec | None:
        """Return the problem in the file of ``--source`` (None without it); warn if the file has changed since a run.

        Raises :class:`~ocp.errors.InputError` if the file cannot be read, or does not define the runs' problem.
        """
        from problems.plugin import edited, named_file

        problem_spec = named_file(self.source, runs)
        for run in runs:
            if warning := edited(run, problem_spec):
                self.output.say(warning)
        return problem_spec


class TagOptions(StoreOptions):
    """Option for tags of the stored run."""

    tags: list[str] | None = option(None, "--tag", metavar="WORD", help="Tag the run; ocp runs --tag WORD finds it.")

    def check(self) -> None:
        """Raise InputError for a tag that is not a single word."""
        from ocp.store.meta import check_tags

        super().check()
        check_tags(self.tags or ())


class LawOptions(StoreOptions):
    """Options for a contact law and its settings."""

    contact: str = option("exact", help=LAW_HELP)
    law_settings: list[str] | None = assignment(
        "--contact-setting", "-c", help="Setting of the contact law; list with ocp settings LAW."
    )


class ProblemOptions(LawOptions, TagOptions):
    """Options for a problem, its contact law, random numbers, and a report of the result."""

    problem: str = argument(help=PROBLEM_HELP)
    params: list[str] | None = assignment("--param", "-p", help="Parameter of the problem; list with ocp show PROBLEM.")
    seed: int = option(0, limits=INDEX, help="Random seed.")
    pdf: Path | None = option(None, help="Write a PDF report to this file.")


class PolicyOptions(ProblemOptions):
    """Options for a policy, and settings of method, policy and solver."""

    policy: str = option("open-loop", help="open-loop or feedback.")
    settings: list[str] | None = assignment(
        "--setting", "-s", help="Setting of method, policy or solver; list with ocp settings."
    )


class SolverOptions(PolicyOptions):
    """Options for transcription method and solver."""

    method: str = option("direct", help="direct, multiple-shooting, ...")
    solver: str = option("ipopt", help="ipopt, fatrop, uno or sleqp.")


class JobsOptions(Options):
    """Options for parallel jobs, in processes of this computer or on a Dask cluster."""

    jobs: int = option(1, "-j", limits=WORKERS, help="Number of parallel processes.")
    scheduler: str | None = option(None, metavar="ADDRESS", help="Address of a Dask scheduler; jobs go to its workers.")

    def check(self) -> None:
        """Raise InputError if both local processes and a cluster are requested."""
        from ocp.errors import InputError

        super().check()
        if self.scheduler is not None and "jobs" in self.explicit:
            raise InputError("--jobs starts local processes, --scheduler uses a cluster; drop one")

    @property
    def parallel(self) -> bool:
        """Whether jobs run outside this process."""
        return self.jobs > 1 or self.scheduler is not None


class StartsOptions(JobsOptions, SolverOptions):
    """Options for several starts of one solve."""

    starts: int = option(1, limits=STARTS, help="Initial guesses per solve.")
    rank: str = option("planned", help="Cost that ranks several starts: planned, exact or referee.")

    def check(self) -> None:
        """Raise InputError for an unknown rank, and for a rank with a single start."""
        from ocp.errors import InputError
        from ocp.solve.starts import check_starts

        super().check()
        check_starts(self.starts, self.seed, self.rank)
        if "rank" in self.explicit and self.starts == 1:
            raise InputError("--rank needs several starts; give --starts 2 or more")
