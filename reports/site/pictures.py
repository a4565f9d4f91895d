"""Pictures of the site: small PNG files, the same on every run."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from ocp.store.atomic import write
from reports.site.measured import DOCS

COLOURS = 96


def save(figure: Figure, name: str) -> Path:
    """Write ``figure`` to ``docs/pictures/<name>.png``, in few colours; returns the file."""
    drawn, small = BytesIO(), BytesIO()
    figure.savefig(drawn, format="png", dpi=110, bbox_inches="tight", metadata={"Software": None})
    picture = Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    picture.save(small, format="png", optimize=True)
    file = DOCS / "pictures" / f"{name}.png"
    write(file, small.getvalue())
    return file
