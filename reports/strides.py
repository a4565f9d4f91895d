"""A periodic motion, one stride after another."""

from __future__ import annotations

from dataclasses import replace

import xarray as xr

from reports.view import RunView


def is_periodic(view: RunView) -> bool:
    """Whether the problem's motion ends as it began."""
    start = view.problem.start if view.problem is not None else None
    return start is not None and bool(start.periodic)


def repeated(view: RunView, count: int) -> RunView:
    """Look at ``count`` strides of a periodic run, each begun where the last one ended.

    States go on by what they gained over the stride (the way forward; nothing for those that are
    periodic), time by its duration; impulses are the same in every stride.
    """
    data = view.run.data.reset_coords()
    nodes = data[[name for name in data if "node" in data[name].dims]]
    gained = nodes.isel(node=-1) - nodes.isel(node=0)
    strides = [nodes.isel(node=slice(bool(k), None)) + k * gained for k in range(count)]
    pushes = data[[name for name in data if "interval" in data[name].dims]]
    again = xr.merge([xr.concat(strides, "node"), xr.concat([pushes] * count, "interval")])
    run = replace(view.run, data=again.set_coords("time"))
    if view.spec is None:
        return replace(view, run=run)
    title = f"{view.spec.title}, the stride {count} times"
    return replace(view, run=run, spec=replace(view.spec, title=title))
