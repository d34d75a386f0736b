"""What every beam policy does."""

from __future__ import annotations

from typing import Protocol

from foreglow.config import BeamConfig
from foreglow.photometry import Headlamps
from foreglow.types import BeamCommand, Frame, Tracks


class BeamPolicy(Protocol):
    """Decides what our headlamps shine."""

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None: ...

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
        """The command that follows from `frame` and its tracks."""
        ...

    def shone(self, command: BeamCommand) -> None:  # noqa: ARG002
        """Told what the guard let pass of the command for the latest frame."""
        return

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        return
