"""The fifth stage: what our headlamps shall shine, checked, and as messages on the car's bus."""

from foreglow.beam.gap_writer import GapWriter
from foreglow.beam.gaps import Gap
from foreglow.beam.guard import Guard
from foreglow.beam.interface import BeamPolicy
from foreglow.beam.occurrence import Occurrence, occurrence
from foreglow.beam.policy import POLICIES, PaperPolicy, make_policy, policy_class
from foreglow.beam.stage import BeamStage

__all__ = [
    "POLICIES",
    "BeamPolicy",
    "BeamStage",
    "Gap",
    "GapWriter",
    "Guard",
    "Occurrence",
    "PaperPolicy",
    "make_policy",
    "occurrence",
    "policy_class",
]
