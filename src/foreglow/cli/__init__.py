"""The command `foreglow`: a module for each command, or for a few that belong together.

Exit codes: 0 done, 2 bad input or arguments, 70 a fault of this program, 130 interrupted. What a command needs is
imported when it runs, so that the help is there at once.
"""

import sys

try:
    from foreglow.cli.signals import (
        INTERRUPTED,
        check_environment,
        end_at_once,
        end_despite_hanging,
        fill_standard_streams,
        interruptible,
    )
except KeyboardInterrupt:
    sys.stderr.write("foreglow: interrupted\n")
    sys.exit(130)

with interruptible():
    fill_standard_streams()
    check_environment()
    from foreglow.cli.app import app

    # In the order of the help.
    from foreglow.cli import run, demo, beam, live, ros2, report, calibrate, export_mot  # noqa: F401  isort: skip
    from foreglow.cli import labels, evaluate, stages, download, simulate, learning, yolo, experiment  # noqa: F401  isort: skip

__all__ = ["app", "main"]


def main() -> None:
    """Runs the command line."""
    try:
        with interruptible():
            try:
                app()
            finally:
                end_at_once()
    except (MemoryError, SystemError):  # before the command has begun; Python's own code then raises the second, too
        sys.stderr.write("foreglow: not enough memory to begin\n")
        sys.exit(2)
    except SystemExit as ending:
        end_despite_hanging(ending.code)
        raise
    except KeyboardInterrupt:  # a second one, while the first is answered
        sys.exit(INTERRUPTED)
    finally:
        end_at_once()
