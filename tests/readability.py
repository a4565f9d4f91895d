"""``python -m tests.readability [N]``: measure the readability of names and docstrings in the four packages.

Prints every measure with its limit, and the first N places of each. The exit code is 1 if a limit is exceeded.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

PACKAGES = ("dynamics", "ocp", "problems", "reports")
VAGUE = re.compile(
    "_*(after|again|along|asked|at|before|began|begun|best|between|both|drawn|ended|far|felt|found|given|gone|good|half"
    "|held|here|kept|known|least|left|made|more|most|moved|near|off|one|own|parts?|put|rest|said|seen|shown|sought|spent"
    "|such|taken|there|tried|told|turned|wanted|ways?|what|where|whole|written)_*"
)
"""Words that say nothing about the value that a variable holds."""
ODD_BEGINNING = re.compile(r"(What|Where|Of|Whose|That|Those|How|Which|Whether it|Not|Nothing|None|Both)\b")
"""First words of a docstring that is neither a noun phrase nor an imperative."""
LONGEST_FILE = 350
"""Maximum number of lines of a module."""
LONGEST_FUNCTION = 60
"""Maximum number of lines of a function."""
MOST_PARAMETERS = 8
"""Maximum number of a function's parameters, not counting ``self`` and ``cls``."""
MOST_MEANINGS = 3
"""Maximum number of modules that define a private constant of the same name."""

LIMITS = {
    "files too long": 0,
    "assignments to vague words, %": 2.0,
    "public functions named by one word, %": 60.0,
    "lines that the formatter skips": 50,
    "docstrings with an odd beginning, %": 2.0,
    "private constants of many meanings": 5,
    "constants assigned as a tuple": 20,
    "constants without a word on them, %": 40.0,
    "functions with too many parameters": 8,
    "functions too long": 8,
    "classes of one name in two modules": 8,
}
"""Mapping from measure to its largest allowed count, or share in percent."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Readings:
    """Places found for each measure and, for shares, the number of all places."""

    places: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    totals: defaultdict[str, int] = field(default_factory=lambda: defaultdict(int))
    modules: defaultdict[str, set[Path]] = field(default_factory=lambda: defaultdict(set))

    def count(self, measure: str, place: str, counts: bool) -> None:
        """Add one place to the total of a measure in percent, and record it if ``counts``."""
        self.totals[measure] += 1
        if counts:
            self.places[measure].append(place)

    def value(self, measure: str) -> float:
        """Return the count of a measure, or its share in percent."""
        number = len(self.places[measure])
        return round(100 * number / max(self.totals[measure], 1), 1) if measure.endswith("%") else number


def read_packages(root: Path) -> Readings:
    """Read every module of the four packages below ``root``."""
    readings = Readings()
    for path in sorted(path for package in PACKAGES for path in (root / package).rglob("*.py")):
        text = path.read_text()
        lines, tree, name = text.splitlines(), ast.parse(text), path.relative_to(root)
        if len(lines) > LONGEST_FILE:
            readings.places["files too long"].append(f"{name}: {len(lines)} lines")
        for number, line in enumerate(lines, 1):
            if re.search(r"#\s*fmt:\s*(skip|off)", line):
                readings.places["lines that the formatter skips"].append(f"{name}:{number}")
        for node in ast.walk(tree):
            read_node(node, name, readings)
        read_constants(tree, lines, name, readings)
    for word, modules in readings.modules.items():
        measure = "private constants of many meanings" if word.isupper() else "classes of one name in two modules"
        if len(modules) > (MOST_MEANINGS if word.isupper() else 1):
            readings.places[measure].append(f"{word}: {', '.join(map(str, sorted(modules)))}")
    return readings


def read_node(node: ast.AST, path: Path, readings: Readings) -> None:
    """Read an assignment, a function, or a docstring."""
    place = f"{path}:{getattr(node, 'lineno', 1)} {getattr(node, 'name', getattr(node, 'id', ''))}"
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        readings.count("assignments to vague words, %", place, VAGUE.fullmatch(node.id) is not None)
    if isinstance(node, Function):
        if not node.name.startswith("_"):
            readings.count("public functions named by one word, %", place, "_" not in node.name)
        names = [each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        if len(set(names) - {"self", "cls"}) > MOST_PARAMETERS:
            readings.places["functions with too many parameters"].append(place)
        if (node.end_lineno or 0) - node.lineno >= LONGEST_FUNCTION:
            readings.places["functions too long"].append(place)
    if isinstance(node, ast.ClassDef):
        readings.modules[node.name if not node.name.isupper() else node.name.title()].add(path)
    if isinstance(node, Function | ast.ClassDef | ast.Module) and (docstring := ast.get_docstring(node)):
        odd = ODD_BEGINNING.match(docstring) is not None
        readings.count("docstrings with an odd beginning, %", f"{place}: {docstring.splitlines()[0]}", odd)


def read_constants(tree: ast.Module, lines: list[str], path: Path, readings: Readings) -> None:
    """Count a module's constants that have neither a docstring below nor a comment above or on the same line."""
    for node, follower in zip(tree.body, [*tree.body[1:], None], strict=False):
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        for names in constant_names(node):
            place = f"{path}:{node.lineno} {', '.join(names)}"
            if len(names) > 1:
                readings.places["constants assigned as a tuple"].append(place)
            docstring = isinstance(follower, ast.Expr) and isinstance(follower.value, ast.Constant)
            comment = lines[node.lineno - 2].lstrip().startswith("#") or "#" in lines[node.lineno - 1]
            readings.count("constants without a word on them, %", place, not (docstring or comment))
            for name in names:
                if name.startswith("_"):
                    readings.modules[name].add(path)


def constant_names(node: ast.Assign | ast.AnnAssign) -> Iterator[list[str]]:
    """Yield the capitalised names that each target of an assignment binds, if it binds any."""
    for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
        elements = target.elts if isinstance(target, ast.Tuple) else [target]
        names = [each.id for each in elements if isinstance(each, ast.Name) and each.id.strip("_").isupper()]
        if names:
            yield names


def main() -> int:
    """Print the table; return 1 where a limit is exceeded."""
    readings = read_packages(Path(__file__).parents[1])
    listed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    exceeded = 0
    for measure, limit in LIMITS.items():
        value = readings.value(measure)
        exceeded += value > limit
        print(f"{value:>8}  {measure} (limit {limit}){'   EXCEEDED' if value > limit else ''}")
        for place in readings.places[measure][:listed]:
            print(f"{'':10}{place}")
    return int(exceeded > 0)


if __name__ == "__main__":
    sys.exit(main())
