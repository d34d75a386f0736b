"""Driving the pipeline: off-line over a source for now; the live loop comes later."""

from foreglow.runtime.apart import Opening, run_apart
from foreglow.runtime.folder import RESULT_NAMES, OutputFolder
from foreglow.runtime.run import ResultSink, run
from foreglow.runtime.stepper import Stepper
from foreglow.runtime.summary import RunSummary

__all__ = ["RESULT_NAMES", "Opening", "OutputFolder", "ResultSink", "RunSummary", "Stepper", "run", "run_apart"]
