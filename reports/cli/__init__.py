"""The command line."""

import os

EXIT_CODE = 130
"""Exit code after Ctrl-C, as shells define it (128 + SIGINT)."""


def end(*_: object) -> None:
    """End the process at once, as a handler of Ctrl-C."""
    try:
        os.write(2, b"stopped by the user\n")
    finally:
        os._exit(EXIT_CODE)
