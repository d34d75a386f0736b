"""The film of a drive: two cars side by side, each with its camera, its LEDs and its light on the road."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from foreglow.display.beam_view import BeamView
from foreglow.display.overlay import CAPTION_BGR, Picture
from foreglow.display.pen import Pen
from foreglow.display.tone import Tone
from foreglow.display.video import Movie
from foreglow.lab.studies.glare.loop import Shone
from foreglow.photometry import Headlamps
from foreglow.types import BeamCommand, BeamMode
from foreglow.whole_files import naming

HEIGHT_PX = 540
"""Of either picture; two of them are as wide as a full HD screen."""

TITLE = 26
"""Height of the titles' capitals, in pixels of a picture of 1080 rows."""


def write_film(
    frames: Iterable[Sequence[Shone]], titles: Sequence[str], headlamps: Headlamps, rate_hz: float, path: Path
) -> None:
    """Writes the MP4 file `path`: what each car's lamps shone in each frame, beside each other.

    Raises:
        OSError: If it cannot be written.
    """
    partial = path.with_name(f".{path.name}.partial")
    movie, view, pen = Movie(partial, rate_hz), BeamView(headlamps, HEIGHT_PX), Pen(HEIGHT_PX)
    tone: Tone | None = None
    try:
        for moment in frames:
            tone = tone or Tone.of(moment[0].known.frame.image)
            tools = view, pen, tone
            pictures = [_picture(shone, title, tools) for shone, title in zip(moment, titles, strict=True)]
            with naming(path, in_place_of=partial):
                movie.add(np.hstack(pictures), moment[0].known.frame.timestamp_ns)
        with naming(path, in_place_of=partial):
            movie.close()
            partial.replace(path)
    except BaseException:
        movie.discard()
        partial.unlink(missing_ok=True)
        raise


def _picture(shone: Shone, title: str, tools: tuple[BeamView, Pen, Tone]) -> Picture:
    """The camera's picture with the light that it was taken in, not with the command that follows from it."""
    view, pen, tone = tools
    is_low = not shone.levels.any()
    gaps_rad = np.zeros((0, 2)) if is_low else shone.gaps_rad
    is_full = shone.levels.min() >= 1.0 and not len(gaps_rad)
    mode = BeamMode.LOW if is_low else BeamMode.FULL if is_full else BeamMode.GLARE_FREE
    command = BeamCommand(
        shone.known.frame.timestamp_ns,
        mode,
        np.asarray(shone.levels, np.float64),
        gaps_rad,
        np.full(len(gaps_rad), np.nan),
        shone.command.faults,
    )
    picture = view.picture(shone.known.frame, command, shone.result.tracks, tone)
    pen.write(picture, title, (pen.px(24), pen.px(24 + TITLE)), CAPTION_BGR, TITLE)
    return picture
