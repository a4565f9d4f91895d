"""Packages above ocp have the functions that ocp calls through entry points."""

from __future__ import annotations

import pytest

from ocp import plugins
from ocp.plugins import Plugin


@pytest.mark.parametrize("plugin", [plugins.problems, plugins.reports], ids=lambda plugin: plugin.package)
def test_a_package_has_the_functions_that_are_called(plugin: Plugin) -> None:
    assert plugin.functions and all(callable(getattr(plugin, name)) for name in plugin.functions)
    with pytest.raises(AttributeError, match="no function 'solve'"):
        _ = plugin.solve
