"""How many of the vehicles in sight are detected, by range.

A view is a vehicle in an image that shows at least one of its lamps. It is detected if an accepted box holds one of
them. Its range is that from the camera to the middle of the lamps that are seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from foreglow.lab.evaluation.ratios import share

NEAR = 0.1
"""Views whose range differs from the required one by no more than this share of it are at that range."""


@dataclass(frozen=True, slots=True)
class Requirement:
    """What UN R48, 6.1.9.3.1.2, asks the sensor system to detect on a straight level road.

    Attributes:
        name: `oncoming` or `ahead`.
        range_m: The distance up to which.
        edges_m: Borders of the bins of ranges; the lower one belongs to a bin.
    """

    name: str
    range_m: float
    edges_m: tuple[float, ...]


REQUIREMENTS = (
    Requirement("oncoming", 400.0, (0.0, 50.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0)),
    Requirement("ahead", 100.0, (0.0, 25.0, 50.0, 75.0, 100.0, 125.0, 150.0, 200.0)),
)


@dataclass(frozen=True, slots=True)
class View:
    """A vehicle in an image that shows a lamp of it.

    Attributes:
        camera: Name of the camera's profile; `scene` for the scene's own.
        weather: Of the drive, such as `dry`.
        seed: Of the drive's scene, the same for every camera.
        vehicle_id: Index of the vehicle in the scene.
        direction: `oncoming` if its front lamps are seen, `ahead` if its rear lamps are.
        range_m: From the camera to the middle of these lamps.
        is_detected: Whether an accepted box holds one of them.
    """

    camera: str
    weather: str
    seed: int
    image_id: int
    vehicle_id: int
    direction: str
    range_m: float
    is_detected: bool


@dataclass(frozen=True, slots=True)
class Group:
    """The views of one requirement, all of them or those in one weather or of one camera.

    Attributes:
        num_drives: Drives that they are from; a drive that several cameras saw counts once.
        shares: By bin of the requirement, the share that is detected; NaN without views.
        counts: By bin, the number of views.
        share_at: Share that is detected of those at the required range.
        num_at: Their number.
        num_drives_at: Drives that these are from.
    """

    name: str
    num_drives: int
    shares: tuple[float, ...]
    counts: tuple[int, ...]
    share_at: float
    num_at: int
    num_drives_at: int


def group(name: str, views: Sequence[View], requirement: Requirement) -> Group:
    """How many of `views` are detected, by range.

    >>> far, near = (View("", "", 7, image, 0, "oncoming", range_m, image > 0)
    ...              for image, range_m in enumerate((390.0, 40.0)))
    >>> found = group("all", [far, near], REQUIREMENTS[0])
    >>> found.shares[0], found.counts, found.share_at
    (1.0, (1, 0, 0, 0, 1, 0, 0), 0.0)
    """
    bins = [[view for view in views if low <= view.range_m < high] for low, high in pairwise(requirement.edges_m)]
    at = [view for view in views if abs(view.range_m - requirement.range_m) <= NEAR * requirement.range_m]
    return Group(
        name=name,
        num_drives=len({view.seed for view in views}),
        shares=tuple(share([view.is_detected for view in members]) for members in bins),
        counts=tuple(map(len, bins)),
        share_at=share([view.is_detected for view in at]),
        num_at=len(at),
        num_drives_at=len({view.seed for view in at}),
    )


def groups(views: Sequence[View], requirement: Requirement) -> dict[str, tuple[Group, ...]]:
    """The groups of one requirement: `all`, and by `weather` and by `camera`."""
    views = [view for view in views if view.direction == requirement.name]

    def by(aspect: str) -> tuple[Group, ...]:
        names = dict.fromkeys(getattr(view, aspect) for view in views)
        of_name = ((name, [view for view in views if getattr(view, aspect) == name]) for name in names)
        return tuple(group(name, members, requirement) for name, members in of_name)

    return {"all": (group("all", views, requirement),), "weather": by("weather"), "camera": by("camera")}
