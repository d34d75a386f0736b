"""Runs the pipeline: off-line over a source, here and in `parallel_run`; in real time in `live` and `ros2`."""

from foreglow.runs.folder import OutputFolder
from foreglow.runs.summary_file import RunSummary
from foreglow.runtime.parallel_run import Opening, run_apart
from foreglow.runtime.run import ResultSink, Stepper, run

__all__ = ["Opening", "OutputFolder", "ResultSink", "RunSummary", "Stepper", "run", "run_apart"]
