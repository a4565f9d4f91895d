"""Label trajectories: names, units and times on every array."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.judge.contact_report import ContactReport, contact_report, least_slip
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout
from ocp.routes.homotopy import RouteResult
from ocp.solution import units_of
from ocp.solve.warm_start import multipliers
from ocp.transcription.nlp import NLP, Trajectories

if TYPE_CHECKING:
    import xarray as xr

Variables = dict[str, Any]
"""What a Dataset is built of, by name: dimensions, values and attributes."""


def label(
    nlp: NLP,
    plan: Trajectories,
    replay: Rollout,
    book: ContactReport,
    outcome: RouteResult,
    evaluation: Evaluation,
    refereed: Rollout,
) -> xr.Dataset:
    """Return the dataset that :class:`~ocp.solution.Solution` documents."""
    import xarray as xr

    problem = nlp.problem
    nodes = ("scenario", "node", "state")
    along = ("scenario", "interval")
    system = problem.system
    # A law that averages has each contact often.
    signals = {
        "state": system.states,
        "control": system.inputs,
        "contact_exact": system.contacts,
        "contact": nlp.step.contacts,
    }
    entries, of = units_of(signals)
    gap_unit = {"units": system.gap_unit}
    mu_unit = {"units": f"{system.contacts[0].unit if system.contacts else 1} {system.gap_unit}"}
    lam, gap = least_slip(nlp.step, plan.lam, plan.gap)
    lam_replay, gap_replay = least_slip(problem.exact_step, replay.lam, replay.gap)
    # Collected and built at once: each variable that is set in a Dataset aligns all the others.
    data: Variables = {
        "x": (nodes, plan.x, of["state"]),
        "u": ((*along, "control"), plan.u, of["control"]),
        "lam": ((*along, "contact"), lam, of["contact"]),
        "gap": ((*along, "contact"), gap, gap_unit),
        "mu": ((*along, "contact"), plan.mu, mu_unit),
        "lam_replay": ((*along, "contact_exact"), lam_replay, of["contact_exact"]),
        "gap_replay": ((*along, "contact_exact"), gap_replay, gap_unit),
    }
    for name, rolled in (("replay", replay), ("referee", refereed)):
        data[f"x_{name}"] = (nodes, rolled.x, of["state"])
        data[f"u_{name}"] = ((*along, "control"), rolled.u, of["control"])
    for name, x in (("phi", plan.x), ("phi_replay", replay.x)):
        phi = evaluation.signed_distances(x)
        if phi is not None:
            data[name] = (("scenario", "node", "distance"), phi, {"units": "m"})
    if problem.system.forces is not None:
        data |= _forces(book, contact_report(evaluation, problem.exact_step, replay))
    if plan.gains is not None:
        N = problem.N
        K = np.broadcast_to(plan.gains.K, (N, *plan.gains.K.shape[1:]))
        k = np.broadcast_to(plan.gains.k, (N, *plan.gains.k.shape[1:]))
        data["K"] = (("interval", "control", "state"), K)
        data["k"] = (("interval", "control"), k)
    data |= multipliers(nlp, outcome.result.point) | _stages(nlp, outcome, len(plan.x))
    data |= {f"{dimension}_unit": (dimension, found) for dimension, found in entries.items()}
    time = evaluation.node_times(plan.x[0, 0])
    coords: Variables = {} if system.forces is None else {"point": list(book.names)}
    coords |= {key: [signal.name for signal in found] for key, found in signals.items()}
    coords["time"] = ("node", time, {"units": "s"})
    coords["time_interval"] = ("interval", time[:-1], {"units": "s"})
    labelled = xr.Dataset(data, coords=coords)
    for variable in labelled.data_vars.values():
        variable.attrs.setdefault("units", "1")
    return labelled


def _forces(planned: ContactReport, exact: ContactReport) -> Variables:
    found: Variables = {}
    for suffix, book in (("", planned), ("_replay", exact)):
        parts = (
            ("normal_impulse", book.normal, "N s"),
            ("friction_impulse", book.tangential, "N s"),
            ("slip", book.slip, "m/s"),
            ("friction_bound", book.bound, "N s"),
            ("active", book.active, "1"),
            ("slipping", book.slipping, "1"),
            ("degenerate", book.degenerate, "1"),
        )
        for name, values, unit in parts:
            dims = ("scenario", "interval", "point")
            found[f"{name}{suffix}"] = (dims, np.asarray(values, dtype=float), {"units": unit})
    return found


def _stages(nlp: NLP, outcome: RouteResult, scenarios: int) -> Variables:
    records = outcome.trace.records
    found: Variables = {
        "stage_label": ("stage", [record.label for record in records]),
        "stage_status": ("stage", [record.status for record in records]),
    }
    for name in ("value", "cost", "complementarity", "residual", "iterations", "seconds"):
        unit = {"units": "s" if name == "seconds" else "1"}
        found[f"stage_{name}"] = ("stage", [getattr(record, name) for record in records], unit)
    kept = [nlp.variables.unpack(x) for _, x in outcome.trace.points if x.size == nlp.n]
    for block in ("x", "u"):
        if kept and block in nlp.variables:
            stack = np.stack([blocks[block] for blocks in kept])
            last = {"x": "state", "u": "control"}[block]
            rows = "scenario" if stack.shape[1] == scenarios else "shared"
            found[f"stage_{block}"] = (("accepted_stage", rows, "interval", last), stack)
    return found
