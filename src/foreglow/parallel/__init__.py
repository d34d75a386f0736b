"""Work in many processes or on many machines: everything goes through `Workers.each`."""

from foreglow.parallel.cluster import Cluster
from foreglow.parallel.local import Local, safe_path
from foreglow.parallel.pool import MAX_DEATHS, Parent, Work, Workers

__all__ = ["MAX_DEATHS", "Cluster", "Local", "Parent", "Work", "Workers", "safe_path", "workers_at"]


def workers_at(jobs: int, cluster: str | None) -> Workers:
    """The workers of the cluster at an address, or `jobs` processes of this machine; 1 stays in this process.

    Raises:
        ValueError: If both are given, or `jobs` is no whole number of at least 1.
    """
    if cluster is None:
        return Local(jobs)
    if jobs != 1:
        raise ValueError(f"expected --jobs or --cluster, got both: the cluster {cluster} has its own number of workers")
    return Cluster(cluster)
