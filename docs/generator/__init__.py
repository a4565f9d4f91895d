"""Generator of the documentation site: writers of ``docs/generated``, and hooks that ``mkdocs`` calls."""
