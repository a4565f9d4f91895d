"""Pages that come from the code: commands, settings, examples, and the architecture."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docs.generator import notebooks
from docs.generator.measured import DOCS, escaped, table
from ocp.distribution import PACKAGES
from reports.cli.app import first_paragraph, load_commands
from reports.tables import settings
from reports.tables.settings import SettingGroup

WIDTH = 80
"""Columns of the terminal whose help texts are shown."""


def pages() -> dict[str, str]:
    """Return the pages on settings, commands, examples and architecture, as a mapping from path to text."""
    return {**settings_pages(), **command_pages(), **example_pages(), **architecture_pages()}


def command_pages() -> dict[str, str]:
    """Return a page with the help of each command, and a page that lists the commands."""
    commands = load_commands()
    rows = [(f"[`ocp {name}`]({name}.md)", first_paragraph(c.help)) for name, c in commands.items()]
    help_pages = {
        f"commands/{name}.md": f"# ocp {name}\n\n```text\n{help_text(name, command)}\n```\n"
        for name, command in commands.items()
    }
    return {"commands/index.md": f"# Commands\n\n{table(('command', 'what it does'), rows)}", **help_pages}


def help_text(name: str, command: Any) -> str:
    """Return the text of ``ocp NAME --help`` in a terminal of 80 columns."""
    context = command.make_context(
        f"ocp {name}", [], resilient_parsing=True, terminal_width=WIDTH, max_content_width=WIDTH
    )
    return command.get_help(context).rstrip()


INTRODUCTIONS = {
    "laws": "Contact laws, `--contact LAW`, and their settings, `-c NAME=VALUE`. `ocp settings"
    " laws` prints the same, `ocp settings adaptive` a single law.",
    "solves": "Methods, strategies and policies of `ocp solve`, and their settings,"
    " `-s NAME=VALUE`. `ocp settings methods` prints the same.",
    "estimators": "Estimators that mix two orders, and their settings, `ocp estimate -s`.",
    "training": "Settings of `ocp train -s`: of all algorithms, and of each.",
    "solver": "Options of IPOPT whose default here differs from IPOPT's. Set them, like every other"
    " option of IPOPT, with `-s NAME=VALUE`. `ocp settings ipopt` lists all of them, with IPOPT's"
    " descriptions.",
}
"""First paragraph of each page of settings."""


def settings_pages() -> dict[str, str]:
    """Return one page each for laws, methods, estimators, training and the solver, and a page that lists them."""
    groups_by_page = {
        "laws": ("Contact laws", settings.law_groups()),
        "solves": ("Methods and policies", settings.method_groups()),
        "estimators": ("Estimators", settings.estimator_groups()),
        "training": ("Training", settings.training_groups()),
        "solver": ("IPOPT", [settings.changed_defaults(settings.solver_group("ipopt"))]),
    }
    rows = [f"- [{name.capitalize()}]({name}.md): {INTRODUCTIONS[name]}\n" for name in groups_by_page]
    head = (
        "# Settings\n\nEvery setting, from its declaration. Unknown settings are refused; the error"
        " names the closest match.\n\n"
    )
    pages = {"settings/index.md": head + "".join(rows)}
    for name, (title, groups) in groups_by_page.items():
        sections = [f"# {title}\n", f"{INTRODUCTIONS[name]}\n", *map(section, groups)]
        pages[f"settings/{name}.md"] = "\n".join(sections)
    return pages


def section(group: SettingGroup) -> str:
    """Return the section of a group of settings: its summary, and a table of the settings."""
    head = f"## {group.name}\n\n{escaped(group.summary)}.\n"
    if not group.settings:
        return f"{head}\nIt has no settings.\n"
    rows = [
        (
            f"`{setting.name}`",
            f"`{text}`" if (text := settings.default_text(setting.default)) else "",
            setting.kind,
            escaped(setting.meaning),
        )
        for setting in group.settings
    ]
    columns = (f"`{group.syntax}`", "default", "value", "meaning")
    return f"{head}\n{table(columns, rows)}"


FOLDER = DOCS.parent / "examples"
"""Folder of the examples."""


def example_pages() -> dict[str, str]:
    """Return a page for each script and notebook of ``examples``, and a page that lists them."""
    files = {file.stem: file for file in (*sorted(FOLDER.glob("*.py")), *sorted(FOLDER.glob("*/*.py")))}
    scripts = {name: file.read_text(encoding="utf-8") for name, file in files.items()}
    rows = [
        (f"[{name}]({name}.md)", (ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0])
        for name, source in scripts.items()
    ]
    books = {file.stem: notebooks.title(file) for file in sorted(FOLDER.glob("*.ipynb"))}
    rows += [(f"[{name}]({name}.md)", f"Notebook: {title}.") for name, title in books.items()]
    example_texts = {
        f"examples/{name}.md": f"<!-- notebook: {name} -->\n\n# {title}\n\nThe site shows"
        f" `examples/{name}.ipynb` here, with what each cell gives.\n"
        for name, title in books.items()
    }
    example_texts |= {
        f"examples/{name}.md": f'# {name}\n\n```python title="{files[name].relative_to(ROOT)}"\n{source}```\n'
        for name, source in scripts.items()
    }
    head = "# Examples\n\nWhole files that run, in `examples/` of the checkout.\n\n"
    return {"examples/index.md": head + table(("", "what it shows"), rows), **example_texts}


ROOT = DOCS.parent
"""Root of the checkout."""
_HEAD = (
    "# Architecture\n\n"
    "Four packages, one direction: `dynamics <- ocp <- problems <- reports`. A system is a "
    "symbolic graph; a contact law closes it; a transcription turns a problem into an NLP; a "
    "route solves it; three judges examine the solution; the store keeps it; reports show it. "
    "The walk of one solve through the files is in `CONTRIBUTING.md`.\n\n"
    "The figure and the table below are drawn from the code: the layers are the import "
    "contracts of `pyproject.toml`, where a line imports only lines below it, and the imports "
    "are read from the source files.\n\n"
)
"""Text above the table of packages."""


def architecture_pages() -> dict[str, str]:
    """Return ``architecture.md``: the layers as text, and a table of packages with their imports."""
    names = sorted(_units())
    rows = [(f"`{name}`", _summary(name), ", ".join(f"`{other}`" for other in _imports(name, names))) for name in names]
    listed = table(("package", "contents", "imports"), rows)
    return {"architecture.md": f"{_HEAD}```text\n{layers()}```\n\n{listed}"}


def layers() -> str:
    """Return the import contracts of ``pyproject.toml`` on layers as text, the lowest layer last."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lines = []
    for contract in settings["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers":
            lines.append("".join(f"{name}/" for name in contract.get("containers", ["."])))
            lines += [f"    {layer}" for layer in contract["layers"]]
    return "\n".join(lines) + "\n"


def _units() -> Iterator[str]:
    """Yield the names of packages one level below the four, such as ``ocp.routes``."""
    for package in PACKAGES:
        for folder in (ROOT / package).iterdir():
            if (folder / "__init__.py").exists():
                yield f"{package}.{folder.name}"


def _summary(name: str) -> str:
    source = (ROOT / name.replace(".", "/") / "__init__.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0].replace("``", "`")


def _imports(name: str, names: list[str]) -> list[str]:
    """Return the other packages among ``names`` that the modules of a package import."""
    imported_packages = set()
    for file in (ROOT / name.replace(".", "/")).rglob("*.py"):
        imported_packages |= {".".join(module.split(".")[:2]) for module in _imported(file)}
    return sorted(imported_packages.intersection(names) - {name})


def _imported(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
