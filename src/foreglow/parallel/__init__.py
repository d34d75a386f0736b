"""Many cores and many machines: one way to have items worked on elsewhere, `Workers.each`."""

from foreglow.parallel.cluster import Cluster
from foreglow.parallel.local import Local
from foreglow.parallel.pool import MAX_DEATHS
from foreglow.parallel.workers import Parent, Work, Workers, workers_at

__all__ = ["MAX_DEATHS", "Cluster", "Local", "Parent", "Work", "Workers", "workers_at"]
