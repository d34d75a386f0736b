"""How well it was predicted where hidden vehicles appear, as a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from foreglow.lab.evaluation.occurrence import NEAR_DEG, LeadScore
from foreglow.lab.reports.numbers import number, percent
from foreglow.lab.reports.page import Table

REMARK = (
    "Where a vehicle comes into sight, told from its light and the road; errors of those of which something was told "
    "at that time."
)


def occurrence_table(leads: Sequence[LeadScore]) -> Table:
    """A row for each lead."""
    columns: dict[str, Callable[[LeadScore], object]] = {
        "before direct sight": lambda lead: f"{lead.lead_s:g} s",
        "hidden vehicles": lambda lead: lead.num,
        "told": lambda lead: lead.num_told,
        "median error": lambda lead: f"{number(lead.median_deg)} deg",
        f"within {NEAR_DEG:g} deg": lambda lead: percent(lead.near_share),
        "held by the gap": lambda lead: percent(lead.covered_share),
        "its median width": lambda lead: f"{number(lead.width_deg, 1)} deg",
        "median error of the time": lambda lead: f"{number(lead.median_s)} s",
    }
    return Table.of(columns, leads)
