"""Search for parameters of the proposal stage with Optuna, from the `train` extra, imported only when it is used."""

from foreglow.lab.learning.tuning.measurement import Measurement
from foreglow.lab.learning.tuning.objectives import OBJECTIVES, SPACES
from foreglow.lab.learning.tuning.search import RESULTS, Finalist, TrialRecord, Tuning, tune
from foreglow.lab.learning.tuning.study import TuningSettings

__all__ = [
    "OBJECTIVES",
    "RESULTS",
    "SPACES",
    "Finalist",
    "Measurement",
    "TrialRecord",
    "Tuning",
    "TuningSettings",
    "tune",
]
