"""Driving the pipeline: off-line over a source for now; the live loop comes later."""

from foreglow.runs.folder import RESULT_NAMES, OutputFolder
from foreglow.runs.summary import RunSummary
from foreglow.runtime.parallel_run import Opening, run_apart
from foreglow.runtime.run import ResultSink, run
from foreglow.runtime.stepper import Stepper

__all__ = ["RESULT_NAMES", "Opening", "OutputFolder", "ResultSink", "RunSummary", "Stepper", "run", "run_apart"]
