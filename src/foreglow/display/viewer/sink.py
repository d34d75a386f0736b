"""A live sink for Rerun's viewer."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from foreglow.display.tone import Tone
from foreglow.display.viewer.entities import (
    Entity,
    box_entities,
    fault_words,
    fixed_entities,
    image_entity,
    lamp_entities,
    log_entity,
    map_entities,
    track_entity,
    word_entity,
)
from foreglow.display.viewer.outputs import Output
from foreglow.rays import RayCaster
from foreglow.runtime.health import Health
from foreglow.runtime.run import KeepingSink
from foreglow.runtime.time_axis import TimeAxis
from foreglow.types import BeamMode, Frame, FrameResult, Tracks

LuxOf: TypeAlias = Callable[[Frame], Mapping[str, float]]
"""Says how much of our light is at other drivers' eyes in a frame, lux, by what the drivers are called."""

JPEG_QUALITY = 75

SHIPPED_COLUMNS = 28
"""LEDs in a row of the lamps that ship."""

NUM_SCORES = 16
"""Of the scores that are plotted of a frame."""

PER_SEQUENCE = ("camera", "map", "lamps", "plots", "states")
"""Entities that a new sequence knows nothing of."""


class RerunSink(KeepingSink):
    """Shows every frame and what the pipeline made of it, in a window, a file or both.

    Sequences follow each other as on a `TimeAxis`; each starts with nothing shown.
    """

    def __init__(
        self,
        outputs: Sequence[Output],
        *,
        num_columns: int = SHIPPED_COLUMNS,
        jpeg_quality: int | None = JPEG_QUALITY,
        lux_of: LuxOf | None = None,
    ) -> None:
        """A sink.

        Args:
            outputs: Where it goes; they are closed with the sink.
            num_columns: LEDs in a row of one lamp.
            jpeg_quality: Of the images, 1..100; None keeps each pixel, five to ten times larger.
            lux_of: Light at other drivers' eyes, where it is known.
        """
        self._outputs = outputs
        self._num_columns = num_columns
        self._jpeg_quality = jpeg_quality
        self._lux_of = lux_of
        self._axis = TimeAxis()
        self._caster = RayCaster()
        self._sequence: str | None = None
        self._tone: Tone | None = None
        self._slots = Slots()
        self._mode: BeamMode | None = None
        self._faults: dict[str, tuple[str, ...]] = {}
        self._num_shown, self._has_failed = 0, False
        for output in outputs:
            output.log_static(fixed_entities())

    @property
    def num_kept(self) -> int:
        """Frames that it has shown; none if a file failed, which then vanishes."""
        return 0 if self._has_failed else self._num_shown

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Shows one frame.

        Raises:
            OSError: If a file cannot be written; the message names the path.
        """
        entities: list[Entity] = []
        if frame.sequence != self._sequence:
            entities += self._begin(frame)
        if self._tone is None or not self._tone.fits(frame.image):
            self._tone = Tone.of(frame.image)
        entities.append(image_entity(frame, self._tone, self._jpeg_quality))
        entities += box_entities(result.proposals, result.detections)
        if result.detections is not None:
            entities.append(("plots/scores", rr.Scalars(highest(result.detections.scores))))
        if result.tracks is not None:
            entities.append(track_entity(result.tracks))
            entities += self._track_plots(result.tracks)
        entities.append(word_entity(frame, result.detections, result.tracks))
        entities += map_entities(frame, result.tracks, result.beam, self._caster)
        if result.beam is not None:
            entities += lamp_entities(result.beam, self._num_columns)
            if result.beam.mode != self._mode:
                self._mode = BeamMode(result.beam.mode)
                entities.append(("states/beam", rr.StateChange(state=self._mode.name.lower())))
            entities += self._note_faults("low beam", result.beam.faults)
        entities += [(f"plots/ms/{stage}", rr.Scalars(ms)) for stage, ms in _stage_times(result.stage_ms).items()]
        if self._lux_of is not None:
            for name, lux in self._lux_of(frame).items():
                entities.append((f"plots/lux/{rr.escape_entity_path_part(name)}", rr.Scalars(lux)))
        self._log(self._axis.time_ns(frame), frame.frame, entities)
        self._num_shown += 1

    def write_health(self, health: Health) -> None:
        """Notes what is wrong, when that changes and its time is known.

        Raises:
            OSError: If a file cannot be written; the message names the path.
        """
        if health.is_timed:
            time_ns = self._axis.within_sequence_ns(health.timestamp_ns)
            self._log(time_ns, None, self._note_faults("health", health.faults))

    def close(self) -> None:
        """Completes the recording; a window stays open.

        Raises:
            OSError: If a file cannot be written; the message names the path.
        """
        with self._noting_failure():
            for output in self._outputs:
                output.close()

    def discard(self) -> None:
        """Removes an incomplete recording; a window stays open."""
        for output in self._outputs:
            output.discard()

    def _begin(self, frame: Frame) -> list[Entity]:
        """Clears what is shown, but for faults of the whole run that last, and chooses the sequence's tone."""
        is_first, self._sequence = self._sequence is None, frame.sequence
        self._tone, self._mode, self._slots = Tone.of(frame.image), None, Slots()
        self._faults.pop("low beam", None)
        named = [log_entity(f"sequence {frame.sequence}", is_fault=False)] if frame.sequence else []
        if is_first:
            return named
        lasting = [_state(origin, faults) for origin, faults in self._faults.items()]
        return [*((name, rr.Clear(recursive=True)) for name in PER_SEQUENCE), *lasting, *named]

    def _track_plots(self, tracks: Tracks) -> list[Entity]:
        """Range and confidence of the plausible tracks, a line each while they live."""
        plausible = np.flatnonzero(tracks.is_plausible)
        taken, freed = self._slots.assign(tracks.ids[plausible].tolist())
        entities: list[Entity] = []
        for slot in freed:
            entities += [(f"plots/{name}/{slot}", rr.Clear(recursive=False)) for name in ("ranges", "confidences")]
        for index, slot in zip(plausible, taken, strict=True):
            entities.append((f"plots/confidences/{slot}", rr.Scalars(tracks.confidences[index])))
            if not math.isnan(tracks.ranges_m[index]):
                entities.append((f"plots/ranges/{slot}", rr.Scalars(tracks.ranges_m[index])))
        return entities

    def _note_faults(self, origin: str, faults: tuple[str, ...]) -> list[Entity]:
        """A line in the log, and the state, where the faults of `origin` changed."""
        if faults == self._faults.get(origin, ()):
            return []
        self._faults[origin] = faults
        words = fault_words(faults)
        text = f"{origin}: {words}" if faults else f"{origin}: no faults any more"
        return [log_entity(text, is_fault=bool(faults)), _state(origin, faults)]

    def _log(self, time_ns: int, number: int | None, entities: Sequence[Entity]) -> None:
        with self._noting_failure():
            for output in self._outputs:
                output.log(time_ns, number, entities)

    @contextlib.contextmanager
    def _noting_failure(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            self._has_failed = True
            raise


def _state(origin: str, faults: tuple[str, ...]) -> Entity:
    """The state of the faults of `origin`, on the timeline."""
    return f"states/{rr.escape_entity_path_part(origin)}", rr.StateChange(state=fault_words(faults) or None)


def highest(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    """The `NUM_SCORES` highest, and NaN where there are fewer: where their number changes the viewer draws zeros.

    >>> highest(np.array([0.25, 0.75], np.float32))[:3]
    array([0.75, 0.25,  nan], dtype=float32)
    """
    kept = np.full(NUM_SCORES, np.nan, np.float32)
    kept[: min(len(scores), NUM_SCORES)] = np.sort(scores)[::-1][:NUM_SCORES]
    return kept


class Slots:
    """Lends few names to many tracks, so that a run of hours has no more plots than tracks at a time.

    >>> slots = Slots()
    >>> slots.assign([7, 9])
    ([0, 1], [])
    >>> slots.assign([9, 12])  # 7 is gone, and 12 has its place, which begins anew
    ([1, 0], [0])
    """

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}

    def assign(self, ids: Sequence[int]) -> tuple[list[int], list[int]]:
        """The slot of each id, and the slots whose id is no longer there."""
        gone = [id_ for id_ in self._slots if id_ not in ids]
        freed = [self._slots.pop(id_) for id_ in gone]
        used = set(self._slots.values())
        free = (slot for slot in range(len(ids) + len(used)) if slot not in used)
        for id_ in ids:
            if id_ not in self._slots:
                self._slots[id_] = next(free)
        return [self._slots[id_] for id_ in ids], freed


def _stage_times(stage_ms: Mapping[str, float]) -> dict[str, float]:
    return {**stage_ms, "total": sum(stage_ms.values())} if stage_ms else {}
