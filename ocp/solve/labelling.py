"""Arrays of solutions: trajectories with names, units and times on every array."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ocp.judge.contact_report import ContactReport, contact_report, least_slip
from ocp.labelled import LabelledArrays
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout
from ocp.routes.homotopy import RouteResult
from ocp.solution import units_of
from ocp.solve.warm_start import multipliers
from ocp.transcription.nlp import NLP, Trajectories

Variables = dict[str, Any]
"""Mapping from the name of an array to its dimensions, values and attributes."""


def label(
    nlp: NLP,
    plan: Trajectories,
    replay: Rollout,
    contacts: ContactReport,
    outcome: RouteResult,
    evaluation: Evaluation,
    refereed: Rollout,
) -> LabelledArrays:
    """Return the arrays of a solution; :class:`~ocp.solution.Solution` describes its variables."""
    problem = nlp.problem
    system = problem.system
    # A law that averages over branches has each contact once per branch.
    signals = {
        "state": system.states,
        "control": system.inputs,
        "contact_exact": system.contacts,
        "contact": nlp.step.contacts,
    }
    entry_units, units = units_of(signals)
    variables = _trajectories(nlp, plan, units) | replay_variables(evaluation, replay, refereed)
    variables |= _distances("phi", evaluation, plan.x)
    if system.forces is not None:
        variables |= _forces("", contacts)
    if plan.gains is not None:
        K, k = plan.gains.K, plan.gains.k
        variables["K"] = (("interval", "control", "state"), np.broadcast_to(K, (problem.N, *K.shape[1:])))
        variables["k"] = (("interval", "control"), np.broadcast_to(k, (problem.N, *k.shape[1:])))
    variables |= multipliers(nlp, outcome.result.point) | _stages(nlp, outcome, len(plan.x))
    variables |= {f"{dimension}_unit": (dimension, names) for dimension, names in entry_units.items()}
    time = evaluation.node_times(plan.x[0, 0])
    coords: Variables = {} if system.forces is None else {"point": list(contacts.names)}
    coords |= {dimension: [signal.name for signal in entries] for dimension, entries in signals.items()}
    coords["time"] = ("node", time, {"units": "s"})
    coords["time_interval"] = ("interval", time[:-1], {"units": "s"})
    return LabelledArrays(variables, coords)


def replay_variables(evaluation: Evaluation, replay: Rollout, refereed: Rollout) -> Variables:
    """Return the arrays of a replay under the exact law, and states and inputs of one by the referee."""
    system, step = evaluation.problem.system, evaluation.problem.exact_step
    intervals, exact = ("scenario", "interval"), ("scenario", "interval", "contact_exact")
    _, units = units_of({"state": system.states, "control": system.inputs, "contact": system.contacts})
    lam, gap = least_slip(step, replay.lam, replay.gap)
    variables: Variables = {
        "lam_replay": (exact, lam, units["contact"]),
        "gap_replay": (exact, gap, {"units": system.gap_unit}),
    }
    for name, rollout in (("replay", replay), ("referee", refereed)):
        variables[f"x_{name}"] = (("scenario", "node", "state"), rollout.x, units["state"])
        variables[f"u_{name}"] = ((*intervals, "control"), rollout.u, units["control"])
    forces = {} if system.forces is None else _forces("_replay", contact_report(evaluation, step, replay))
    return variables | _distances("phi_replay", evaluation, replay.x) | forces


def _distances(name: str, evaluation: Evaluation, x: np.ndarray) -> Variables:
    """Return the true signed distances at states as the array ``name``; empty without geometry."""
    phi = evaluation.signed_distances(x)
    return {} if phi is None else {name: (("scenario", "node", "distance"), phi, {"units": "m"})}


def _trajectories(nlp: NLP, plan: Trajectories, units: Mapping[str, dict[str, str]]) -> Variables:
    """Return states, inputs and contacts of the plan."""
    system, intervals = nlp.problem.system, ("scenario", "interval")
    gap_unit = {"units": system.gap_unit}
    mu_unit = {"units": f"{system.contacts[0].unit if system.contacts else 1} {system.gap_unit}"}
    lam, gap = least_slip(nlp.step, plan.lam, plan.gap)
    return {
        "x": (("scenario", "node", "state"), plan.x, units["state"]),
        "u": ((*intervals, "control"), plan.u, units["control"]),
        "lam": ((*intervals, "contact"), lam, units["contact"]),
        "gap": ((*intervals, "contact"), gap, gap_unit),
        "mu": ((*intervals, "contact"), plan.mu, mu_unit),
    }


def _forces(suffix: str, contacts: ContactReport) -> Variables:
    """Return the forces and states of contacts, as arrays whose names end with ``suffix``."""
    dims = ("scenario", "interval", "point")
    return {
        f"{name}{suffix}": (dims, np.asarray(values, dtype=float), {"units": unit})
        for name, values, unit in (
            ("normal_impulse", contacts.normal, "N s"),
            ("friction_impulse", contacts.tangential, "N s"),
            ("slip", contacts.slip, "m/s"),
            ("friction_bound", contacts.bound, "N s"),
            ("active", contacts.active, "1"),
            ("slipping", contacts.slipping, "1"),
            ("degenerate", contacts.degenerate, "1"),
        )
    }


def _stages(nlp: NLP, outcome: RouteResult, scenarios: int) -> Variables:
    records = outcome.trace.records
    variables: Variables = {
        "stage_label": ("stage", [record.label for record in records]),
        "stage_status": ("stage", [record.status for record in records]),
    }
    for name in ("value", "cost", "complementarity", "residual", "iterations", "seconds"):
        unit = {"units": "s" if name == "seconds" else "1"}
        variables[f"stage_{name}"] = ("stage", [getattr(record, name) for record in records], unit)
    accepted = [nlp.variables.unpack(x) for _, x in outcome.trace.points if x.size == nlp.n]
    for block in ("x", "u"):
        if accepted and block in nlp.variables:
            stack = np.stack([blocks[block] for blocks in accepted])
            last = {"x": "state", "u": "control"}[block]
            rows = "scenario" if stack.shape[1] == scenarios else "shared"
            variables[f"stage_{block}"] = (("accepted_stage", rows, "interval", last), stack)
    return variables
