"""Parameters of the live loop."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from foreglow.config.fields import FrozenModel


class LiveConfig(FrozenModel):
    """Parameters of the live loop; `docs/live.md` says what it does about what goes wrong.

    A frame's time is one over the source's rate. With the defaults each fault means low beam at most two frames' time
    after a frame was missing, late, or the second in a row that is wrong.

    Attributes:
        rate_hz: Frames a second that are expected of a source that does not tell its own rate.
        silent_frames: After so many frames' time without a frame the camera is gone.
        slow_frames: Two frames in a row that each come later than so many frames' time are of a slow camera.
        num_steady: So many frames in time, in a row, end that.
        max_step_s: A stage that keeps a frame longer hangs.
        abandon_s: After this further time the pipeline that hangs is left alone, and a new one is made.
        max_failures: After so many frames in a row at which a stage raised, a new pipeline is made.
        retry_s: Between attempts to open a source that was lost, or to make a pipeline.
    """

    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 18.0
    silent_frames: Annotated[float, Field(gt=1, le=100)] = 2.5
    slow_frames: Annotated[float, Field(gt=1, le=100)] = 1.6
    num_steady: Annotated[int, Field(ge=1, le=1000)] = 5
    max_step_s: Annotated[float, Field(gt=0, le=10)] = 0.08
    abandon_s: Annotated[float, Field(gt=0, le=100)] = 1.0
    max_failures: Annotated[int, Field(ge=1, le=1000)] = 3
    retry_s: Annotated[float, Field(gt=0, le=100)] = 1.0
