"""Runs the pipeline: off-line over a source, here and in `parallel_run`; in real time in `live` and `ros2`."""

from foreglow.runs.folder import RESULT_NAMES, OutputFolder
from foreglow.runs.summary import RunSummary
from foreglow.runtime.parallel_run import Opening, run_apart
from foreglow.runtime.run import ResultSink, run
from foreglow.runtime.stepper import Stepper

__all__ = ["RESULT_NAMES", "Opening", "OutputFolder", "ResultSink", "RunSummary", "Stepper", "run", "run_apart"]
