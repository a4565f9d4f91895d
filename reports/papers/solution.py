"""The bare figure of a solved problem: its motion above, states, inputs and forces below."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ocp.errors import InputError
from reports.forces import acting_contacts, forces_of
from reports.strobe import draw_strobe
from reports.style import CYCLE, INK, WIDTH
from reports.units import label
from reports.view import RunView

_COLUMNS = 3
_ROW, _TALLEST = 1.75, 3.0
_DASHES = ("-", (0, (4, 2)))
_LEVEL = 1e-6
"""Of its size, below which a change is drawn as none."""
_LINE = 0.14
"""Height of a line of the key, of a panel's."""


@dataclass(frozen=True)
class SignalGroup:
    """Quantities of one unit: names, planned values (S, n, k), and replayed ones or None."""

    title: str
    names: list[str]
    planned: np.ndarray
    replayed: np.ndarray | None


def solution_figure(view: RunView) -> Figure:
    """Draw a solved run: the strobe, and a panel for each unit of states, inputs and forces.

    Solid lines are planned, dashed ones replayed under the exact law.

    Raises :class:`~ocp.errors.InputError` for a run that is no solve.
    """
    if view.run.kind != "solve" or view.array("x") is None:
        raise InputError(
            f"{view.run.path} holds a {view.run.kind} study, expected a run of ocp solve"
        )
    shown = groups(view)
    rows = -(-len(shown) // _COLUMNS)
    drawn = view.picture is not None
    figure = Figure(figsize=(WIDTH, _ROW * rows + 0.4))
    grid = figure.add_gridspec(rows + drawn, min(_COLUMNS, len(shown)))
    if drawn:
        strobe = figure.add_subplot(grid[0, :])
        draw_strobe(strobe, view)
        ratio = float(np.ptp(strobe.get_ylim()) / np.ptp(strobe.get_xlim()))
        height = float(np.clip(0.9 * WIDTH * ratio + 0.6, 1.4, _TALLEST))
        grid.set_height_ratios([height, *[_ROW] * rows])
        figure.set_figheight(height + _ROW * rows + 0.4)
    for place, group in enumerate(shown):
        row, column = divmod(place, _COLUMNS)
        _draw(figure.add_subplot(grid[row + drawn, column]), view.time, group)
    if any(group.replayed is not None for group in shown):
        law = view.run.record.get("contact", "chosen")
        texts = f"planned under the {law} law", "replayed under the exact law"
        handles = [
            Line2D([], [], color=INK, linestyle=dash, label=text)
            for dash, text in zip(_DASHES, texts, strict=True)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def groups(view: RunView) -> list[SignalGroup]:
    """States and inputs unit by unit in the order of the system, then the contacts that act."""
    found = []
    for kind, name in (("states", "x"), ("inputs", "u")):
        values, again = view.array(name), view.array(f"{name}_replay")
        if values is None:
            continue
        signals = view.signals(kind)
        for unit in dict.fromkeys(signal.unit for signal in signals):
            own = [i for i, signal in enumerate(signals) if signal.unit == unit]
            replayed = None if again is None else again[..., own]
            names = [signals[i].name for i in own]
            found.append(SignalGroup(label(kind, unit), names, values[..., own], replayed))
    pushed = _pushed(view)
    return found if pushed is None else [*found, pushed]


def _pushed(view: RunView) -> SignalGroup | None:
    """Size of the force of every contact that acts, in scenario 0."""
    forces, (sizes, acting) = forces_of(view), acting_contacts(view)
    if forces is None or not acting:
        return None
    planned, *replayed = (size[None][..., [*acting]] for size in sizes.values())
    what = "impulses" if forces.unit == "N s" else "contact forces"
    return SignalGroup(label(what, forces.unit), [*acting.values()], planned, *(replayed or [None]))


def _draw(axis: Axes, time: np.ndarray, group: SignalGroup) -> None:
    for values, dash in zip((group.planned, group.replayed), _DASHES, strict=True):
        if values is None:
            continue
        look = {"linestyle": dash, "linewidth": 1.1 if len(values) == 1 else 0.6}
        for i, name in enumerate(group.names):
            for scenario, line in enumerate(values[..., i]):
                color = CYCLE[i % len(CYCLE)]
                text = name if dash == _DASHES[0] and scenario == 0 else None
                if line.size < time.size:
                    axis.stairs(line, time, baseline=None, color=color, label=text, **look)
                else:
                    axis.plot(time, line, color=color, label=text, **look)
    low, high = axis.get_ylim()
    if high - low < _LEVEL * max(abs(low), abs(high)):
        half = 0.05 * max(abs(low), abs(high))
        low, high = low - half, high + half
    columns = 1 + len(group.names) // 4
    rows = -(-len(group.names) // columns)
    # Names stand in a part of their own, above the lines.
    axis.set_ylim(low, high + _LINE * rows * (high - low))
    axis.set_title(group.title, loc="left")
    axis.set_xlabel("time [s]")
    axis.legend(fontsize=6.5, ncols=columns, handlelength=1.0, columnspacing=0.8,
                labelspacing=0.2, borderaxespad=0.2, loc="upper left")  # fmt: skip
