"""The figures of one policy on one drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.studies.glare.drive import GlareDrive, PolicyRun
from foreglow.lab.studies.glare.metrics import (
    BINS,
    RESTORE_S,
    Dimming,
    EyeScore,
    Limits,
    PhaseLight,
    Switching,
    phase_light,
    phases,
    score_eye,
    switching,
    wrong_dimming,
)


@dataclass(frozen=True, slots=True)
class DriveScore:
    """One policy on one drive: what adds up to its figures.

    Attributes:
        drive: The scene.
        scenario: What was drawn.
        is_empty: Whether there is no other driver at all.
        eyes: Other drivers.
        present: Light on the road while a vehicle is there.
        passed: Light on the road after the vehicle has passed and light had time to return.
        switching: How much the light changes.
        dimming: Light dimmed while nobody is there.
    """

    drive: str
    scenario: str
    is_empty: bool
    eyes: tuple[EyeScore, ...]
    present: PhaseLight
    passed: PhaseLight
    switching: Switching
    dimming: Dimming

    def of_group(self, is_oncoming: bool) -> tuple[EyeScore, ...]:
        """The oncoming, or the preceding drivers."""
        return tuple(eye for eye in self.eyes if eye.is_oncoming == is_oncoming)

    def dose_lxs(self, is_oncoming: bool) -> float:
        """Of all oncoming, or all preceding drivers."""
        return math.fsum(eye.dose_lxs for eye in self.of_group(is_oncoming))

    def doses_lxs(self, is_oncoming: bool) -> Floats:
        """Shape (B, 2): by bin, the dose of the policy and of the low beam alone."""
        doses = [[(glare.dose_lxs, glare.low_dose_lxs) for glare in eye.bins] for eye in self.of_group(is_oncoming)]
        return np.asarray(np.array(doses, np.float64).reshape(-1, len(BINS.bin_names), 2).sum(axis=0))


def score_drive(drive: GlareDrive, run: PolicyRun, limits: Limits, restore_s: float = RESTORE_S) -> DriveScore:
    """What one policy did on one drive."""
    when = phases(drive, restore_s)
    return DriveScore(
        drive=drive.name,
        scenario=drive.scenario,
        is_empty=not drive.eyes and not drive.light_s,
        eyes=tuple(score_eye(drive, eye, run.levels, limits) for eye in drive.eyes),
        present=phase_light(drive, run, when.is_present),
        passed=phase_light(drive, run, when.is_passed),
        switching=switching(drive, run),
        dimming=wrong_dimming(drive, run, when.is_free),
    )
