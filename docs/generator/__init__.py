"""The documentation site: what writes ``docs/generated``, and what ``mkdocs`` calls in building."""
