"""Access to packages of higher layers, which must not be imported: entry points load them at the first call."""

from __future__ import annotations

from typing import Any

from ocp.distribution import DISTRIBUTION_NAME, ShadowedPackage, shadowing
from ocp.errors import InputError

PLUGIN_GROUP = "centralpath.plugins"
"""Group of entry points for the packages of higher layers."""


class Plugin:
    """A package of a higher layer; its attributes are those of its ``functions`` that this package calls.

    The first call loads the module of the entry point with this name. It raises
    :class:`~ocp.errors.InputError` if the distribution is not installed, and
    :class:`~ocp.distribution.ShadowedPackage` if a user's module of the same name is imported instead.
    """

    def __init__(self, package: str, *functions: str) -> None:
        self.package, self.functions = package, functions

    def __getattr__(self, function: str) -> Any:
        if function not in self.functions:
            raise AttributeError(f"{self.package} has no function {function!r} for ocp")
        return getattr(self.load(), function)

    def load(self) -> Any:
        """Return the module of the entry point; it is loaded at the first call."""
        from importlib.metadata import PackageNotFoundError, distribution

        # Entry points of all installed distributions take forty times as long to read as those of this one.
        try:
            plugin = distribution(DISTRIBUTION_NAME).entry_points.select(group=PLUGIN_GROUP)[self.package]
        except (PackageNotFoundError, KeyError):
            raise InputError(
                f"the package {self.package} of {DISTRIBUTION_NAME} is not installed; install the distribution, as in"
                f" pip install {DISTRIBUTION_NAME}"
            ) from None
        try:
            return plugin.load()
        except ImportError as error:
            if hidden := shadowing((self.package,)):
                raise ShadowedPackage(hidden) from error
            raise


problems = Plugin(
    "problems", "get", "source", "named", "named_file", "load_law", "edited", "problem_of", "gradient_case"
)
"""Functions that return named problems and scenes, and those of users' files and stored runs."""
reports = Plugin("reports", "main", "plot", "animate", "report", "html")
"""Functions for the command line, and for figures, films, PDFs and HTML of a solution."""
