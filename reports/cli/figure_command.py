"""``ocp figure ID...``: reproduce figures of the papers, with their claims checked.

A stored run in place of an ID is drawn again as a bare figure, without any computation.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, StoreOptions, argument, option

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun
    from problems.studies import FigureStudy


@dataclass(frozen=True, kw_only=True)
class FigureOptions(StoreOptions):
    """The figures, and their parameters."""

    figures: list[str] | None = argument(
        default=None, help="Figures, such as P6 (ocp list), or stored runs to draw again."
    )
    every: bool = option(False, "--all", help="All figures.")
    quick: bool = option(False, "--quick", help="Smaller sizes for long studies.")
    params: list[str] | None = option(
        None, "--param", "-p", metavar="K=V", help="Parameter of the study."
    )
    seed: int = option(0, "--seed", min=0, help="Seed of everything random.")
    ending: str | None = option(
        None, "--format", metavar="pdf|svg|png", help="Also write the bare figure for a paper."
    )
    panel: str | None = option(
        None, "--panel", metavar="a", help="Only this panel of the bare figure, one column wide."
    )

    @property
    def named_runs(self) -> list[str]:
        """Runs that the command reads, as given."""
        return [name for name in self.figures or () if _names_run(name)]


FigureRequest = list["tuple[FigureStudy, dict[str, Any]] | StoredRun"]


def check(options: FigureOptions) -> FigureRequest:
    """Find the studies, each with all its parameters, and the stored runs."""
    from ocp.errors import InputError, choose
    from problems import studies
    from reports.cli.request import assignments, check_places
    from reports.papers.formats import FORMATS

    named = options.figures or []
    if options.every == bool(named):
        raise InputError(f"give figures or --all; available: {', '.join(studies.ids())}")
    values: dict[str, Any] = assignments("-p", options.params)
    if values and len(named) != 1:
        raise InputError("-p sets a parameter of one study; name a single figure")
    if "seed" in values and "seed" in options.given:
        raise InputError("--seed and -p seed set the same value; drop one of them")
    if options.ending is not None:
        choose("format", options.ending, FORMATS)
    if options.panel is not None and options.panel not in set(ascii_lowercase):
        raise InputError(f"--panel must be a letter from a to z, got {options.panel!r}")
    names = list(dict.fromkeys(named)) or studies.ids()
    given = {"seed": options.seed, **values}
    found = [_stored(name, options.out) or _study(name, given, options) for name in names]
    check_places(options.out, None)
    return found


def _stored(name: str, root: Path) -> StoredRun | None:
    """The run of a name that is a path or ``@last``; None for the name of a study."""
    from reports.cli.runs_command import stored

    return stored(name, root) if _names_run(name) else None


def _names_run(name: str) -> bool:
    return name.startswith("@") or "/" in name


def _study(
    name: str, given: dict[str, Any], options: FigureOptions
) -> tuple[FigureStudy, dict[str, Any]]:
    from ocp.effort import check_memory, study_memory
    from problems import studies

    study = studies.get(name)
    params = study.params({**(study.quick if options.quick else {}), **given}).model_dump()
    counts = {n: f.default for n, f in study.Params.model_fields.items() if f.annotation is int}
    growth = math.prod(max(1.0, params[n] / usual) for n, usual in counts.items() if usual)
    check_memory(f"{study.id} with {', '.join(options.params or ())}", study_memory(growth))
    return study, params


def run(options: FigureOptions, request: FigureRequest) -> int:
    """Run a study, store it, draw it as ID.pdf beside its data ID.nc, and check its claims.

    With --format or --panel the bare figure is written as well, for a paper: ID-figure.pdf, or
    ID-a.pdf for panel a. A stored run is drawn again without any computation.
    """
    done = [
        _reproduce(*one, options) if isinstance(one, tuple) else _again(one, options)
        for one in request
    ]
    options.output.document(done[0] if len(options.figures or ()) == 1 else {"figures": done})
    return 0


def _again(run: StoredRun, options: FigureOptions) -> dict[str, Any]:
    """Draw a stored run as a bare figure."""
    file = _bare(run, options)
    options.output.say(f"files: {file}")
    return {"id": run.meta["problem"], "files": [str(file)], "run": str(run.path)}


def _bare(run: StoredRun, options: FigureOptions) -> Path:
    from ocp.store import atomic
    from reports.papers.bare import bare

    ending = options.ending or "pdf"
    file = options.out / f"{run.meta['problem']}-{options.panel or 'figure'}.{ending}"
    atomic.write(file, bare(run, ending, options.panel), "the figure")
    return file


@contextmanager
def _explained(study: FigureStudy, params: dict[str, Any]) -> Iterator[None]:
    """Raise InputError, with the values, for a study that fails at values other than its defaults.

    At its defaults a failure is a defect. Elsewhere a study may have no result: ranges are checked
    one by one, and a ball may land outside the whole observed interval.
    """
    from ocp.errors import InputError

    usual = study.params({}).model_dump()
    chosen = [f"{name}={value}" for name, value in params.items()
              if name != "seed" and value != usual[name]]  # fmt: skip
    try:
        yield
    except (ArithmeticError, IndexError, ValueError) as error:
        if not chosen or isinstance(error, InputError):
            raise
        reason = " ".join(str(error).split())
        raise InputError(
            f"{study.id} has no result at {', '.join(chosen)} ({reason}); choose values closer to"
            " its defaults"
        ) from error


def _reproduce(
    study: FigureStudy, params: dict[str, Any], options: FigureOptions
) -> dict[str, Any]:
    from dataclasses import asdict

    from ocp import store
    from ocp.store import atomic
    from ocp.store.checkpoint import Checkpoint
    from problems.studies.study import did_hold
    from reports.pdf import write_pdf
    from reports.tables import claim_table

    out, output = options.out, options.output
    if not output.quiet:
        print(f"{study.id}: {study.title}", file=sys.stderr, flush=True)
    with Checkpoint(out if study.resumes else None, study.id, params) as kept:
        for line in kept.notes:
            output.say(line)
        with _explained(study, params):
            data = study.data(params, kept)
            claims = study.claims(data)
        meta = {
            "kind": "figure",
            "argv": options.argv,
            "seed": params["seed"],
            "record": {"params": params},
            "claims": [asdict(claim) for claim in claims],
            "verdict": did_hold(claims),
            "status": "done",
        }
        stored = store.write(out, study.id, data, meta)
        kept.discard()
    pdf, copy = out / f"{study.id}.pdf", out / f"{study.id}.nc"
    with _explained(study, params):
        write_pdf([stored], pdf)
    # netCDF 3: HDF5 stamps its root group with the time of writing.
    atomic.write(copy, bytes(data.to_netcdf(engine="scipy", format="NETCDF3_64BIT")))
    output.note(claim_table(claims))
    output.say(f"{study.id}: {meta['verdict']}")
    files = [str(pdf), str(copy)]
    if options.ending or options.panel:
        files.append(str(_bare(stored, options)))
    output.say(f"files: {', '.join(files)}")
    return {"id": study.id, "title": study.title, "files": files, "run": str(stored.path),
            "seed": params["seed"], "claims": meta["claims"]}  # fmt: skip


COMMAND = Command(
    FigureOptions,
    check,
    run,
    examples=(
        "figure A1",
        "figure --all --quick --out studies",
        "figure P3 P6 --format svg --panel b",
    ),
)
