"""Page of the report on a study: its figure, and claims of the paper next to measured values."""

from __future__ import annotations

from ocp.store.stored_run import StoredRun
from problems import studies
from problems.studies.study import claim_verdict, origin_of
from reports.documents.common import Page, run_summary
from reports.figures.studies import DRAWINGS


def study_page(run: StoredRun) -> Page:
    """Return content and figure of the page on a stored study; raises ``InputError`` for an unknown study."""
    study = studies.get(run.meta["problem"])
    content, fields = run_summary(run, study, run.record["params"]), study.Params.model_fields
    content |= {
        "title": f"{study.id}: {study.title}",
        "caption": DRAWINGS[study.id].caption,
        "claims": [
            {**claim, "mark": claim_verdict(claim["holds"], claim.get("margin"))} for claim in run.meta["claims"]
        ],
        "notes": list(study.notes),
        "parameters": [[*row, origin_of(fields[row[0]])] for row in content["parameters"]],
    }
    return content, {"study": DRAWINGS[study.id].draw(run.data)}
