"""Command line of the workbench, the program ``ocp``."""

import os

EXIT_CODE = 130
"""Exit code after Ctrl-C, as shells define it (128 + SIGINT)."""


def end(*_: object) -> None:
    """Signal handler for Ctrl-C that ends the process at once."""
    try:
        os.write(2, b"stopped by the user\n")
    finally:
        os._exit(EXIT_CODE)
