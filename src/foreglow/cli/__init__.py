"""The command `foreglow`: parses, calls, and turns errors into one line and an exit code.

Exit codes: 0 done, 2 bad input or arguments, 130 interrupted by Ctrl-C. What a command needs is imported when it runs,
so that help is there at once. A module a subject; their order here is that of the help.
"""

from foreglow.cli.app import app

from foreglow.cli import running, recording, beaming, living, networking, reporting  # noqa: F401  isort: skip
from foreglow.cli import calibrating, tracking, evaluating, simulating, learning, experimenting  # noqa: F401  isort: skip

__all__ = ["app", "main"]


def main() -> None:
    """Runs the command line."""
    app()
