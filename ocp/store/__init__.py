"""Store of runs: requests and results on disk."""

from ocp.store.lookup import default_root, find_run
from ocp.store.runs import (
    SCHEMA,
    check_writable,
    in_memory_run,
    list_runs,
    load,
    problem_parts,
    read_entry,
    read_meta,
    run_paths,
    save,
    write_run,
)
from ocp.store.stored_run import StoredRun

__all__ = [
    "SCHEMA",
    "StoredRun",
    "check_writable",
    "default_root",
    "find_run",
    "in_memory_run",
    "list_runs",
    "load",
    "problem_parts",
    "read_entry",
    "read_meta",
    "run_paths",
    "save",
    "write_run",
]
