"""What the experiment on occurrence prints."""

from __future__ import annotations

from collections.abc import Sequence

from foreglow.lab.evaluation.occurrence import Sighting, lead_scores
from foreglow.lab.reports.occurrence import REMARK, occurrence_table


def report_lines(sightings: Sequence[Sighting]) -> list[str]:
    """A remark and a table in Markdown; nothing without sightings."""
    return [REMARK, occurrence_table(lead_scores(sightings)).markdown()] if sightings else []
