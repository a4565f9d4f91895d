"""The backends that can be tested here: `llvm` where its extra is installed."""

from __future__ import annotations

import importlib.util

LLVM = ["llvm"] if importlib.util.find_spec("llvmlite") else []
FAST = ["c", *LLVM, "numpy"]
BACKENDS = [*FAST, "casadi"]
