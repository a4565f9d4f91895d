"""``ocp runs export RUN -o FILE``: a run's numbers as CSV or NPZ."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from reports.cli.options import Command, RunOptions, option

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun

    Asked = tuple[StoredRun, str]


@dataclass(frozen=True, kw_only=True)
class SaveAsOptions(RunOptions):
    """Which run, the file, and its format."""

    file: Path = option(MISSING, "--output", "-o", help="The file to write.")
    form: str | None = option(
        None, "--format", metavar="csv|npz", help="csv or npz; if not said, by the file's name."
    )


def check(options: SaveAsOptions) -> Asked:
    """Read the run, and see that it has such a form."""
    from ocp.errors import choose
    from ocp.store import flat
    from reports.cli.places import check_place
    from reports.cli.runs_command import stored

    check_place(options.file, "data")
    form = options.form or options.file.suffix.removeprefix(".").lower()
    choose("format", form, flat.FORMATS)
    found = stored(options.run, options.out)
    if form == "csv":
        flat.check_rows(found)
    return found, form


def run(options: SaveAsOptions, asked: Asked) -> int:
    """Write the numbers of a stored run to a file that other programs read.

    CSV has a row a scenario and node (of a continuation also a point; a row a point and estimator,
    or an iteration, of an estimate or a training), and units in the head. NPZ has every array by
    name, and the run's description as JSON in meta.
    """
    from ocp.store import flat

    found, form = asked
    flat.FORMATS[form](found, options.file)
    options.output.say(f"{form}: {options.file}")
    options.output.document({"file": str(options.file), "format": form, "run": str(found.path)})
    return 0


COMMAND = Command(
    SaveAsOptions, check, run,
    examples=("runs export @last -o motion.csv", "runs export push-disc -o push.npz"),
)  # fmt: skip
