"""``ocp figure ID``: reproduce a paper's figure, with its claims checked."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from reports.cli.common import Debug, Json, Output, Quiet, Seed

if TYPE_CHECKING:
    from problems.studies import Study


def run(
    figure: Annotated[str | None, typer.Argument(help="Figure, such as P6; ocp list.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Every figure there is.")] = False,
    params: Annotated[
        list[str] | None,
        typer.Option("--param", "-p", metavar="K=V", help="Parameter of the study."),
    ] = None,
    seed: Seed = 0,
    out: Annotated[Path, typer.Option("--out", help="Where files and runs go.")] = Path("runs"),
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Run a study, store it, draw it as ID.pdf beside its data ID.nc, and check its claims."""
    from ocp import store
    from ocp.errors import InputError
    from problems import studies
    from reports.cli.choices import assignments

    if every == (figure is not None):
        raise InputError(f"give one figure or --all; there are {', '.join(studies.ids())}")
    values = assignments("-p", params)
    if every and values:
        raise InputError("-p belongs to one figure's study; name the figure instead of --all")
    store.check_writable(out)
    output = Output(as_json, quiet)
    chosen = [studies.get(name) for name in (studies.ids() if every else [str(figure)])]
    done = [_reproduce(study, {"seed": seed, **values}, out, output) for study in chosen]
    output.document({"figures": done} if every else done[0])
    return 0


def _reproduce(study: Study, values: dict[str, Any], out: Path, output: Output) -> dict[str, Any]:
    from dataclasses import asdict

    from ocp import store
    from ocp.store import atomic
    from problems.studies.study import did_hold
    from reports import console
    from reports.pdf import write_pdf

    if not output.quiet:
        print(f"{study.id}: {study.title}", file=sys.stderr, flush=True)
    asked = study.params(values).model_dump()
    data = study.data(asked)
    claims = study.claims(data)
    meta = {
        "kind": "figure",
        "argv": ["ocp", *sys.argv[1:]],
        "seed": asked["seed"],
        "record": {"params": asked},
        "claims": [asdict(claim) for claim in claims],
        "verdict": did_hold(claims),
        "status": "done",
    }
    stored = store.write(out, study.id, data, meta)
    pdf, copy = out / f"{study.id}.pdf", out / f"{study.id}.nc"
    write_pdf([store.load(stored)], pdf)
    # netCDF 3: HDF5 stamps its root group with the time of writing.
    atomic.write(copy, bytes(data.to_netcdf(engine="scipy", format="NETCDF3_64BIT")))
    output.note(console.claim_table(claims))
    output.say(f"{study.id}: {meta['verdict']}")
    files = [str(pdf), str(copy)]
    output.say(f"files: {', '.join(files)}")
    return {"id": study.id, "title": study.title, "files": files, "run": str(stored),
            "seed": asked["seed"], "claims": meta["claims"]}  # fmt: skip
