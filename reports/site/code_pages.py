"""Pages that come from the code: commands, settings, and examples."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from typing import Any

from ocp.transcription import METHODS
from reports import settings
from reports.cli.app import commands, first_paragraph
from reports.settings import SettingGroup
from reports.site.markdown import escaped, table
from reports.site.measured import DOCS

WIDTH = 80


def pages() -> dict[str, str]:
    """All of these pages."""
    return {**settings_pages(), **command_pages(), **example_pages()}


def command_pages() -> dict[str, str]:
    """Help of every command, and a list of them."""
    found = commands()
    rows = [(f"[`ocp {name}`]({name}.md)", first_paragraph(c.help)) for name, c in found.items()]
    written = {
        f"commands/{name}.md": f"# ocp {name}\n\n```text\n{help_text(name, command)}\n```\n"
        for name, command in found.items()
    }
    return {
        "commands/index.md": f"# Commands\n\n{table(('command', 'what it does'), rows)}",
        **written,
    }


def help_text(name: str, command: Any) -> str:
    """The text of ``ocp NAME --help`` in a terminal of 80 columns."""
    context = command.make_context(
        f"ocp {name}", [], resilient_parsing=True, terminal_width=WIDTH, max_content_width=WIDTH
    )
    return command.get_help(context).rstrip()


INTRODUCTIONS = {
    "laws": "Contact laws, `--contact LAW`, and their settings, `-c NAME=VALUE`. `ocp laws` prints"
    " the same, `ocp laws adaptive` a single law.",
    "solves": "Methods and policies of `ocp solve`, and their settings, `-s NAME=VALUE`."
    " `ocp methods` prints the same.",
    "estimators": "Estimators that mix two orders, and their settings, `ocp estimate -s`.",
    "training": "Settings of `ocp train -s`: of all algorithms, and of each.",
    "solver": "Options of IPOPT whose default here differs from IPOPT's. Set them, like every other"
    " option of IPOPT, with `-s NAME=VALUE`. `ocp settings ipopt` lists all of them, with IPOPT's"
    " descriptions.",
}


def settings_pages() -> dict[str, str]:
    """A page each for laws, methods, estimators, training and the solver, and a list."""
    methods = [(f"`{name}`", escaped(method.summary)) for name, method in METHODS.items()]
    solves = [settings.solves(), *settings.policies()]
    written = {
        "laws": settings_page("Contact laws", INTRODUCTIONS["laws"], settings.laws()),
        "solves": settings_page(
            "Methods and policies",
            f"{INTRODUCTIONS['solves']}\n\n{table(('`--method`', ''), methods)}",
            solves,
        ),
        "estimators": settings_page(
            "Estimators", INTRODUCTIONS["estimators"], settings.estimators()
        ),
        "training": settings_page("Training", INTRODUCTIONS["training"], settings.training()),
        "solver": settings_page(
            "IPOPT", INTRODUCTIONS["solver"], [settings.changed(settings.solver("ipopt"))]
        ),
    }
    return {
        "settings/index.md": settings_index(),
        **{f"settings/{name}.md": text for name, text in written.items()},
    }


def settings_index() -> str:
    """The list of these pages."""
    rows = "".join(
        f"- [{name.capitalize()}]({name}.md): {introduction}\n"
        for name, introduction in INTRODUCTIONS.items()
    )
    return (
        "# Settings\n\nEvery setting, from its declaration. An unknown one is refused;"
        f" the error names the closest match.\n\n{rows}"
    )


def settings_page(title: str, introduction: str, groups: Sequence[SettingGroup]) -> str:
    """One page: an introduction, then a table per group."""
    return "\n".join([f"# {title}\n", f"{introduction}\n", *map(section, groups)])


def section(group: SettingGroup) -> str:
    """One group: its summary and its settings."""
    head = f"## {group.name}\n\n{escaped(group.summary)}.\n"
    if not group.settings:
        return f"{head}\nIt has no settings.\n"
    rows = [
        (f"`{one.name}`", code(settings.default_text(one.default)), one.kind, escaped(one.meaning))
        for one in group.settings
    ]
    columns = (f"`{group.syntax}`", "default", "value", "meaning")
    return f"{head}\n{table(columns, rows)}"


def code(text: str) -> str:
    """A default in code font; nothing for none."""
    return f"`{text}`" if text else ""


FOLDER = DOCS.parent / "examples"


def example_pages() -> dict[str, str]:
    """A page per script of ``examples``, and a list of scripts and notebooks."""
    scripts = {file.stem: file.read_text(encoding="utf-8") for file in sorted(FOLDER.glob("*.py"))}
    rows = [(f"[{name}]({name}.md)", first_sentence(source)) for name, source in scripts.items()]
    rows += [(f"`{book.name}`", "a notebook") for book in sorted(FOLDER.glob("*.ipynb"))]
    written = {
        f"examples/{name}.md": f'# {name}\n\n```python title="examples/{name}.py"\n{source}```\n'
        for name, source in scripts.items()
    }
    head = "# Examples\n\nWhole files that run, in `examples/` of the checkout.\n\n"
    return {"examples/index.md": head + table(("", "what it shows"), rows), **written}


def first_sentence(source: str) -> str:
    """The first sentence of a script's docstring."""
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0].replace("\n", " ")
