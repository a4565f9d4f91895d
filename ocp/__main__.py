"""``python -m ocp``: the command line."""

from __future__ import annotations

import sys

from ocp.distribution import load_plugin

if __name__ == "__main__":
    sys.exit(load_plugin("reports").main())
