"""``python -m ocp``: the command line."""

from __future__ import annotations

import sys

from ocp.floors import lent

if __name__ == "__main__":
    sys.exit(lent("reports").main())
