"""Problem files to begin with, each whole and solvable as it is; ``ocp new`` writes a copy."""

from pathlib import Path


def template(kind: str, name: str) -> str:
    """The text of a file of ``kind`` (plain, scene or machine), whose problem is ``name``."""
    text = Path(__file__).with_name(f"{kind}.py").read_text(encoding="utf-8")
    return text.replace(f'name = "{kind}"', f'name = "{name}"', 1)
