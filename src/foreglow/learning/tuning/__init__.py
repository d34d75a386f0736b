"""Search for parameters of the proposal stage with Optuna; needs the `train` extra, imported only when it is used."""

from foreglow.learning.tuning.measurement import Measurement
from foreglow.learning.tuning.objectives import OBJECTIVES
from foreglow.learning.tuning.search import Finalist, TrialRecord, Tuning, TuningSettings, tune
from foreglow.learning.tuning.spaces import SPACES

__all__ = ["OBJECTIVES", "SPACES", "Finalist", "Measurement", "TrialRecord", "Tuning", "TuningSettings", "tune"]
