"""The program: its options, and its errors in one line."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperGroup

EXTRAS = {
    **dict.fromkeys(("onnx", "torch", "optuna"), "train"),
    **dict.fromkeys(("mitsuba", "drjit"), "sim"),
    **dict.fromkeys(("libreyolo", "torchvision"), "yolo"),
    **dict.fromkeys(("cantools", "can"), "can"),
    **dict.fromkeys(("foxglove", "lz4", "zstandard"), "recordings"),
    **dict.fromkeys(("rclpy", "rmw_fastrtps_cpp"), "ros2"),
    **dict.fromkeys(("dask", "distributed"), "scale"),
    "rerun": "view",
    "matplotlib": "plots",
    "ultralytics": "ultralytics",
    "trackeval": "mot",
}
"""Optional modules, and the extra that installs each."""


class Commands(TyperGroup):
    """The commands, with their errors turned into one line on stderr."""

    def invoke(self, ctx: Any) -> Any:
        """Runs the command.

        Raises:
            typer.Exit: With code 2 for bad input and 130 for Ctrl-C. With `--debug` the error itself is raised.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            line, code = "interrupted", 130
        except BrokenPipeError:  # the reader of the output, such as `head`, has closed it
            raise
        except (ValueError, OSError, ModuleNotFoundError) as error:
            is_ours = not isinstance(error, ModuleNotFoundError) or error.name in EXTRAS
            if ctx.params["debug"] or not is_ours:
                raise
            line, code = _one_line(error), 2
        typer.echo(f"foreglow: {line}", err=True)
        raise typer.Exit(code)


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Foreglow: provident vehicle detection at night.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _show_version(is_wanted: bool) -> None:
    if is_wanted:
        import foreglow

        typer.echo(f"foreglow {foreglow.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None: ...


def _one_line(error: Exception) -> str:
    """The error as one line."""
    if isinstance(error, ModuleNotFoundError):
        extra = EXTRAS[str(error.name)]
        return f"{error.name} is not installed; this command needs: pip install 'foreglow[{extra}]'"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())
