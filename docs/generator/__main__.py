"""``python -m docs.generator`` (``make generated``) writes all generated pages of the site."""

from __future__ import annotations

from docs.generator import code_pages, figures, gallery, parts
from docs.generator.measured import DATA, GENERATED, table_pages
from ocp.store.atomic import write_file


def pages() -> dict[str, str]:
    """Return a mapping from the path below ``docs/generated`` to the text of every generated page."""
    return {**gallery.pages(), **figures.pages(), **table_pages(), **code_pages.pages(), **parts.pages()}


def main() -> None:
    """Write all pages, and delete those that are no longer generated."""
    page_texts = pages()
    for name, text in page_texts.items():
        write_file(GENERATED / name, text.encode())
    for file in GENERATED.rglob("*.md"):
        if not file.is_relative_to(DATA) and file.relative_to(GENERATED).as_posix() not in page_texts:
            file.unlink()


if __name__ == "__main__":
    main()
