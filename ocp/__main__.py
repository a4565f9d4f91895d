"""Entry point of ``python -m ocp``: the command line."""

from __future__ import annotations

import sys

from ocp import plugins

if __name__ == "__main__":
    sys.exit(plugins.reports.main())
