"""Tables and JSON of transitions and learned models: content, ranges, errors."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Group
from rich.text import Text

from dynamics.learned.training import Epoch
from dynamics.learned.transitions import Transitions
from reports.tables.console import live, number, table_of


def data_document(data: Transitions) -> dict[str, Any]:
    """Return the JSON document on transitions that ``ocp collect`` and ``ocp show data.nc`` print."""
    provenance = data.provenance
    return {
        "kind": "transitions",
        "problem": provenance.get("problem"),
        "params": provenance.get("parameters"),
        "rows": len(data),
        "hash": data.hash,
        **_origin(provenance),
        "coordinates": _coordinates(
            data.names, data.units, len(data.states), data.z, data.normalisation.shift, data.normalisation.scale
        ),
    }


def _origin(provenance: Mapping[str, Any]) -> dict[str, Any]:
    keys = ("seed", "how", "in_tube", "unsolved", "region")
    return {key: provenance.get(key) for key in keys}


def model_dataset(model: xr.Dataset, fitted: xr.Dataset, data: Transitions, held_out: int) -> xr.Dataset:
    """Return the content of a model's file: the model, its fit, and the origin of its data."""
    ranges = {"z_least": ("z", data.z.min(axis=0)), "z_most": ("z", data.z.max(axis=0))}
    attributes = {
        "data_rows": len(data),
        "held_out": held_out,
        "provenance": json.dumps(dict(data.provenance), sort_keys=True),
    }
    return model.merge(fitted).assign(ranges).assign_attrs(attributes)


def model_document(dataset: xr.Dataset) -> dict[str, Any]:
    """Return the JSON document on a model that ``ocp learn`` and ``ocp show model.nc`` print.

    ``data`` and ``fit`` are None for a model that was made without the command.
    """
    attributes = dataset.attrs
    sigma, scale = float(attributes["sigma"]), dataset["z_scale"].values
    names, units = ([str(n) for n in dataset[key].values] for key in ("z", "z_unit"))
    has_fit = "data_rows" in attributes
    # Without a fit the file lacks the ranges of the data.
    unknown = np.full(len(names), np.nan)
    ends = [dataset[name].values if has_fit else unknown for name in ("z_least", "z_most")]
    shift, nx = dataset["z_shift"].values, dataset.sizes["state"]
    coordinates = _coordinates(names, units, nx, np.stack(ends), shift, scale)
    layers = int(attributes.get("layers", 0))
    return {
        "kind": attributes["kind"],
        "problem": attributes["problem"] or None,
        "params": json.loads(attributes["parameters"]) or None,
        "sigma": sigma,
        "seed": int(attributes["seed"]),
        "hidden": [dataset.sizes[f"unit_{layer}"] for layer in range(layers - 1)] or None,
        "hash": attributes["data_hash"],
        "data": None
        if not has_fit
        else {
            "rows": int(attributes["data_rows"]),
            "held_out": int(attributes["held_out"]),
            **_origin(json.loads(attributes["provenance"])),
        },
        "coordinates": [{**row, "noise": sigma * row["scale"]} for row in coordinates],
        "fit": _fit(dataset, names[:nx], units[:nx]) if has_fit else None,
    }


def _fit(dataset: xr.Dataset, names: list[str], units: list[str]) -> dict[str, Any]:
    """Return errors on held-out rows, absolute and relative to the states' scales, and predictions away from data."""
    from dynamics.learned.fit import Fit

    fit = Fit.from_dataset(dataset)
    scaled = (fit.clean * fit.y_scale, fit.noised * fit.y_scale)
    errors = (*scaled, fit.clean, fit.noised)
    keys = ("name", "unit", "clean", "noised", "clean_relative", "noised_relative")
    rays = (fit.distances, fit.displacement, fit.outside)
    return {
        "sigma": fit.sigma,
        "states": [dict(zip(keys, row, strict=True)) for row in zip(names, units, *errors, strict=True)],
        "outside": [
            dict(zip(("distance", "displacement", "beyond"), row, strict=True)) for row in zip(*rays, strict=True)
        ],
    }


def _coordinates(
    names: list[str], units: list[str], nx: int, z: np.ndarray, shift: np.ndarray, scale: np.ndarray
) -> list[dict[str, Any]]:
    columns = zip(names, units, z.min(axis=0), z.max(axis=0), shift, scale, strict=True)
    return [
        {
            "name": name,
            "unit": unit,
            "role": "state" if i < nx else "input",
            "least": float(lowest),
            "most": float(highest),
            "shift": float(centre),
            "scale": float(width),
        }
        for i, (name, unit, lowest, highest, centre, width) in enumerate(columns)
    ]


def origin_lines(document: Mapping[str, Any]) -> list[str]:
    """Return lines on the origin of transitions, or of a model and its data."""
    system_name = document["problem"] or "an unnamed system"
    data_hash = f"data {document['hash'][:16]}"
    if document["kind"] == "transitions":
        return [
            f"{document['rows']} transitions of {system_name}, {document['how'] or 'from elsewhere'}",
            *_collection_lines(document),
            data_hash,
        ]
    data, sizes = document["data"], document["hidden"]
    shape = f", hidden layers of {', '.join(map(str, sizes))}" if sizes else ""
    head = f"{document['kind']} of {system_name}{shape}: sigma {document['sigma']:g}, normalised"
    if data is None:
        return [head, data_hash]
    split_text = f"learned from {data['rows'] - data['held_out']} transitions, {data['held_out']} held out"
    sampling_lines = _collection_lines(data) or [data["how"] or "imported"]
    return [head, f"{split_text}, seed {document['seed']}", *sampling_lines, data_hash]


def _collection_lines(document: Mapping[str, Any]) -> list[str]:
    """Return a list with one line on the sampling of collected data; the list is empty for imported data."""
    if document.get("in_tube") is None:
        return []
    near_text = f"{document['in_tube']} near the line from start to goal"
    return [f"drawn with seed {document['seed']}: {near_text}; {document['unsolved']} unsolved, left out"]


def document_tables(document: Mapping[str, Any]) -> list[Group]:
    """Return tables of ranges and scales and, for a fitted model, of errors and of predictions away from data."""
    fitted = document.get("fit") is not None
    model_tables = [fit_table(document), outside_table(document)] if fitted else []
    return [coordinate_table(document), *model_tables]


def coordinate_table(document: Mapping[str, Any]) -> Group:
    """Return a table of each state and input: its range, and the shift and scale that normalise it."""
    keys = [key for key in ("least", "most", "shift", "scale", "noise") if key in document["coordinates"][0]]
    table = table_of("", "", "unit", *(f">{key}" for key in keys))
    for row in document["coordinates"]:
        table.add_row(row["role"], row["name"], row["unit"], *(number(row[k], 4) for k in keys))
    noise = f"; noise = {document['sigma']:g} scale" if "noise" in keys else ""
    return Group(table, f"normalised: (value - shift) / scale{noise}")


def fit_table(document: Mapping[str, Any]) -> Group:
    """Return a table of root-mean-square errors on held-out rows, one row per state."""
    keys = ("clean", "noised", "clean_relative", "noised_relative")
    heads = [f">{key.replace('_relative', '/scale')}" for key in keys]
    table = table_of("held-out error", "unit", *heads)
    for row in document["fit"]["states"]:
        table.add_row(row["name"], row["unit"], *(number(row[key], 3) for key in keys))
    rows, sigma = document["data"]["held_out"], document["fit"]["sigma"]
    return Group(table, f"root mean square of {rows} rows; noised: inputs perturbed by {sigma:g} scale")


def outside_table(document: Mapping[str, Any]) -> Group:
    """Return a table of the model's predictions at several distances from the data."""
    table = table_of(">distance from the data", ">displacement", ">beyond the data")
    for row in document["fit"]["outside"]:
        share = f"{100 * row['beyond']:.0f} %"
        table.add_row(number(row["distance"]), number(row["displacement"], 3), share)
    return Group(
        table,
        "normalised; displacement: distance of the prediction from that at the edge of the data",
        "(zero for an average); beyond: predictions outside the range of the data",
    )


@contextmanager
def show_epochs(quiet: bool, epochs: int) -> Iterator[Callable[[Epoch, str], None]]:
    """Yield a callback that reports epochs: a live line on a terminal, otherwise one line per ten epochs.

    The arguments of the callback are an epoch and the text at the beginning of its line.
    """
    start_s, first = time.monotonic(), dict[str, int]()
    with live(quiet, every_s=math.inf) as show:

        def report(epoch: Epoch, name: str) -> None:
            done = epoch.number - first.setdefault(name, epoch.number - 1)
            seconds = (time.monotonic() - start_s) / done
            time_left = f", {seconds * (epochs - epoch.number):.0f} s left"
            errors = f"loss {number(epoch.train, 3)}, held out {number(epoch.noised, 3)}"
            text = f"{name}epoch {epoch.number} of {epochs}, {errors}"
            is_due = epoch.number % 10 == 0 or epoch.number == epochs
            show(text if is_due else "", is_due, lambda: Text(text + time_left))

        yield report
