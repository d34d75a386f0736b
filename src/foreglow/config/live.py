"""Parameters of the live loop."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from foreglow.config.fields import FrozenModel


class LiveConfig(FrozenModel):
    """Parameters of the live loop; `docs/live.md` describes the faults and what follows from them.

    A frame period is one over the source's rate. With the defaults there is low beam at most two frame periods after a
    frame was missing or late, or after the second wrong frame in a row.

    Attributes:
        rate_hz: The expected frame rate of a source that does not know its own.
        silent_frames: After so many frame periods without a frame the camera is gone.
        slow_frames: The camera is slow when two frames in a row each come later than so many frame periods.
        num_steady: It no longer is after so many punctual frames in a row.
        max_step_s: A stage that takes longer for a frame hangs.
        abandon_s: After this further time the pipeline that hangs is abandoned, and a new one is made.
        max_failures: After errors in so many frames in a row a new pipeline is made.
        retry_s: Pause between attempts to open a lost source, or to make a pipeline.
    """

    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 18.0
    silent_frames: Annotated[float, Field(gt=1, le=100)] = 2.5
    slow_frames: Annotated[float, Field(gt=1, le=100)] = 1.6
    num_steady: Annotated[int, Field(ge=1, le=1000)] = 5
    max_step_s: Annotated[float, Field(gt=0, le=10)] = 0.08
    abandon_s: Annotated[float, Field(gt=0, le=100)] = 1.0
    max_failures: Annotated[int, Field(ge=1, le=1000)] = 3
    retry_s: Annotated[float, Field(gt=0, le=100)] = 1.0
