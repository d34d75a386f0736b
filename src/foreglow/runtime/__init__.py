"""Driving the pipeline: `run` and `run_apart` off line over a source, `live` in the car, `ros2` as nodes of ROS 2."""

from foreglow.runs.folder import RESULT_NAMES, OutputFolder
from foreglow.runs.summary import RunSummary
from foreglow.runtime.parallel_run import Opening, run_apart
from foreglow.runtime.run import ResultSink, run
from foreglow.runtime.stepper import Stepper

__all__ = ["RESULT_NAMES", "Opening", "OutputFolder", "ResultSink", "RunSummary", "Stepper", "run", "run_apart"]
