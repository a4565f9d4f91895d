"""Label trajectories: names, units and times on every array."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.systems import Signal
from ocp.judges.audit import signed_distances
from ocp.physics.contact_book import ContactBook, contact_book
from ocp.problem import Problem
from ocp.rollout import Rollout
from ocp.routes.outcome import Outcome
from ocp.transcription.nlp import NLP
from ocp.transcription.trajectories import Trajectories
from ocp.warm_start import multipliers, node_times

if TYPE_CHECKING:
    import xarray as xr

Variables = dict[str, Any]
"""What a Dataset is built of, by name: dimensions, values and attributes."""


def label(
    nlp: NLP,
    plan: Trajectories,
    replay: Rollout,
    book: ContactBook,
    outcome: Outcome,
    values: dict[str, float],
    refereed: Rollout,
) -> xr.Dataset:
    """Return the dataset that :class:`~ocp.solution.Solution` documents."""
    import xarray as xr

    problem = nlp.problem
    physical = problem.parameters.pack(values)
    nodes = ("scenario", "node", "state")
    along = ("scenario", "interval")
    # Collected and built at once: each variable that is set in a Dataset aligns all the others.
    data: Variables = {
        "x": (nodes, plan.x),
        "u": ((*along, "control"), plan.u),
        **{name: ((*along, "contact"), getattr(plan, name)) for name in ("lam", "gap", "mu")},
        "x_replay": (nodes, replay.x),
        "u_replay": ((*along, "control"), replay.u),
        "x_referee": (nodes, refereed.x),
        "u_referee": ((*along, "control"), refereed.u),
        "lam_replay": ((*along, "contact_exact"), replay.lam),
        "gap_replay": ((*along, "contact_exact"), replay.gap),
    }
    for name, x in (("phi", plan.x), ("phi_replay", replay.x)):
        phi = signed_distances(problem, x, physical)
        if phi is not None:
            data[name] = (("scenario", "node", "distance"), phi)
    if problem.system.forces is not None:
        data |= _forces(book, _exact_book(problem, replay, physical))
    if plan.gains is not None:
        N = problem.N
        K = np.broadcast_to(plan.gains.K, (N, *plan.gains.K.shape[1:]))
        k = np.broadcast_to(plan.gains.k, (N, *plan.gains.k.shape[1:]))
        data["K"] = (("interval", "control", "state"), K)
        data["k"] = (("interval", "control"), k)
    data |= multipliers(nlp, outcome.result.point) | _stages(nlp, outcome, len(plan.x))
    data |= _entry_units(problem, plan.lam.shape[-1])
    labelled = xr.Dataset(data, coords=_coordinates(nlp, physical, plan.x[0, 0], book))
    _add_units(labelled, problem)
    return labelled


def _exact_book(problem: Problem, replay: Rollout, physical: np.ndarray) -> ContactBook:
    """Keep the books of a replay under the exact law."""
    step = problem.exact_step
    return contact_book(problem, step, replay.x, replay.u, replay.lam, replay.gap, physical)


def _forces(planned: ContactBook, exact: ContactBook) -> Variables:
    found: Variables = {}
    for suffix, book in (("", planned), ("_replay", exact)):
        parts = (
            ("normal_impulse", book.normal, "N s"),
            ("friction_impulse", book.tangential, "N s"),
            ("slip", book.slip, "m/s"),
            ("friction_bound", book.bound, "N s"),
            ("acts", book.acts, "1"),
            ("slides", book.slides, "1"),
            ("weak", book.weak, "1"),
        )
        for name, values, unit in parts:
            dims = ("scenario", "interval", "point")
            found[f"{name}{suffix}"] = (dims, np.asarray(values, dtype=float), {"units": unit})
    return found


def _names(signals: tuple[Signal, ...]) -> list[str]:
    return [signal.name for signal in signals]


def _coordinates(nlp: NLP, physical: np.ndarray, start: np.ndarray, book: ContactBook) -> Variables:
    problem, system = nlp.problem, nlp.problem.system
    time = node_times(problem, physical, start)
    points: Variables = {"point": list(book.names)} if system.forces is not None else {}
    return points | {
        "state": _names(system.states),
        "control": _names(system.inputs),
        "contact": _names(nlp.step.contacts),
        "contact_exact": _names(system.contacts),
        "time": ("node", time, {"units": "s"}),
        "time_interval": ("interval", time[:-1], {"units": "s"}),
    }


def _stages(nlp: NLP, outcome: Outcome, scenarios: int) -> Variables:
    records = outcome.trace.records
    found: Variables = {
        "stage_knob": ("stage", [record.knob for record in records]),
        "stage_status": ("stage", [record.status for record in records]),
    }
    for name in ("value", "cost", "complementarity", "residual", "iterations", "seconds"):
        found[f"stage_{name}"] = ("stage", [getattr(record, name) for record in records])
    kept = [nlp.variables.unpack(x) for _, x in outcome.trace.points if x.size == nlp.n]
    for block in ("x", "u"):
        if kept and block in nlp.variables:
            stack = np.stack([blocks[block] for blocks in kept])
            last = {"x": "state", "u": "control"}[block]
            rows = "scenario" if stack.shape[1] == scenarios else "shared"
            found[f"stage_{block}"] = (("accepted_stage", rows, "interval", last), stack)
    return found


def _entry_units(problem: Problem, contacts: int) -> Variables:
    """Units of every state, input and contact; a law that averages has each contact often."""
    system = problem.system
    exact = [signal.unit for signal in system.contacts]
    units = {
        "state": [signal.unit for signal in system.states],
        "control": [signal.unit for signal in system.inputs],
        "contact_exact": exact,
        "contact": exact * (contacts // max(1, system.nlam)),
    }
    return {f"{dimension}_unit": (dimension, values) for dimension, values in units.items()}


def _add_units(data: xr.Dataset, problem: Problem) -> None:
    system = problem.system
    per_entry = {
        "x": "state_unit", "x_replay": "state_unit", "x_referee": "state_unit",
        "u": "control_unit", "u_referee": "control_unit",
        "u_replay": "control_unit", "lam": "contact_unit", "lam_replay": "contact_exact_unit",
    }  # fmt: skip
    contact_unit = system.contacts[0].unit if system.contacts else "1"
    simple = {"gap": system.gap_unit, "gap_replay": system.gap_unit, "phi": "m",
              "phi_replay": "m", "mu": f"{contact_unit} {system.gap_unit}"}  # fmt: skip
    for name, variable in data.data_vars.items():
        key = str(name)
        if key in per_entry:
            dimension = per_entry[key]
            found = sorted(set(data[dimension].values.tolist()))
            variable.attrs["units"] = found[0] if len(found) == 1 else f"see {dimension}"
        elif key in simple:
            variable.attrs["units"] = simple[key]
        elif key == "stage_seconds":
            variable.attrs["units"] = "s"
        else:
            variable.attrs.setdefault("units", "1")
