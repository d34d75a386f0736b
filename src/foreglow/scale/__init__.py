"""Many cores and many machines: one way to have items worked on elsewhere, `Workers.each`."""

from foreglow.scale.cluster import Cluster
from foreglow.scale.crew import MAX_DEATHS
from foreglow.scale.local import Local
from foreglow.scale.workers import Parent, Work, Workers, workers_at

__all__ = ["MAX_DEATHS", "Cluster", "Local", "Parent", "Work", "Workers", "workers_at"]
