"""The whole fifth stage: a policy, low beam where the road is lit, and the guard."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

from foreglow.beam.guard import Guard
from foreglow.beam.in_sight import lamps_in_sight
from foreglow.beam.interface import BeamPolicy
from foreglow.beam.lit_street import ROAD_LIT, LitStreet
from foreglow.beam.policy import POLICIES, make_policy
from foreglow.config import BeamConfig, GuardConfig, LitStreetConfig
from foreglow.photometry import read_headlamps
from foreglow.plugins import METHODS, built, check_methods, checked
from foreglow.types import BeamCommand, Frame, Tracks
from foreglow.types.arrays import check_callables, check_kind, check_optional, checked_time_ns

MAX_GAPS = 2000
"""Gaps of a frame: one for each track that it may have."""


MOST_MIN_DIRECT = 0.5
"""However sure a policy wants to be of a lamp, the guard protects every track that is one more likely than not."""


class BeamStage:
    """Turns each frame's tracks into a beam command: what the policy wants, as far as the guard allows it.

    A policy of somebody else gets copies: whatever it does to them, the guard judges the frame that came and what the
    tracker found, and what the guard has passed is what is sent. After low beam, and where the guard alone has dimmed,
    light returns in `restore_s` as well, if that is longer than the guard's `brightening_s`; so cars that take gaps are
    told.
    """

    def __init__(
        self,
        config: BeamConfig,
        guard: GuardConfig,
        policy: BeamPolicy | type[BeamPolicy] | None = None,
        lit_street: LitStreetConfig | None = None,
    ) -> None:
        """Reads the lamps and makes the policy.

        Args:
            config: Parameters of the policy.
            guard: Parameters of the guard, which checks the commands of every policy.
            policy: A policy, an object or a class; None for the one that `config` names.
            lit_street: Parameters of what finds lit streets; None for the defaults.

        Raises:
            FileNotFoundError: If the file that describes the lamps does not exist.
            ValueError: If it is broken, or there is no such policy; the message says what was expected.
        """
        check_kind("config", config, BeamConfig)
        check_kind("guard", guard, GuardConfig)
        check_optional("lit_street", lit_street, LitStreetConfig)
        if policy is not None:
            check_methods("policy", policy, METHODS["policy"])
        headlamps = read_headlamps(config.headlamps)
        self._min_direct = min(config.min_direct, MOST_MIN_DIRECT)
        self._policy = built(policy, make_policy, config, headlamps)
        self._is_ours = type(self._policy) in POLICIES.values()
        self._lit_street = LitStreet(lit_street or LitStreetConfig(), guard.white_level)
        if config.restore_s > guard.brightening_s:
            guard = guard.model_copy(update={"brightening_s": config.restore_s})
        self._guard = Guard(guard, headlamps)

    def command(
        self,
        frame: Frame,
        tracks: Tracks,
        *,
        now_ns: Callable[[], int] | None = None,
        faults: Sequence[str] = (),
    ) -> BeamCommand:
        """The beam command after `frame`.

        Args:
            frame: The frame.
            tracks: Its tracks.
            now_ns: The frames' clock, which the guard reads when the policy is done; None off line.
            faults: As `pipeline_faults` of `Guard.check`.

        Raises:
            ValueError: If an argument is of another kind, or a plug-in returns something that is no command, or more
                than `MAX_GAPS`.
        """
        check_kind("frame", frame, Frame)
        check_kind("tracks", tracks, Tracks)
        if now_ns is not None:
            check_callables(now_ns=now_ns)
        given = (frame, tracks) if self._is_ours else (copy.copy(frame), copy.deepcopy(tracks))
        wanted = checked("beam.policy", self._policy.command(*given), BeamCommand)
        if len(wanted.gaps_rad) > MAX_GAPS:
            raise ValueError(f"beam.policy: expected at most {MAX_GAPS} gaps of a frame, got {len(wanted.gaps_rad)}")
        if self._lit_street.update(frame):
            faults = (*faults, ROAD_LIT)
        passed = self._guard.check(
            wanted,
            tracks,
            frame,
            time_ns=None if now_ns is None else checked_time_ns("now_ns", now_ns()),
            pipeline_faults=faults,
            is_vehicle=lamps_in_sight(tracks, self._min_direct, frame.camera),
        )
        self._policy.shone(passed if self._is_ours else copy.deepcopy(passed))
        return passed

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._guard.reset()
        self._lit_street.reset()
        self._policy.reset()

    def resume(self) -> None:
        """Has policy and light begin anew after an error; what says that light must stay off is not forgotten."""
        self._guard.resume()
        self._policy.reset()
