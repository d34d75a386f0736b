"""Environment variables that ROS 2 reads when it is loaded: who can see our topics, and how images are transported."""

from __future__ import annotations

import ctypes
import importlib.util
import os
from collections.abc import MutableMapping
from pathlib import Path
from xml.etree import ElementTree

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
MIDDLEWARE = "RMW_IMPLEMENTATION"
ASSERTED = "RCL_ASSERT_RMW_ID_MATCHES"
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables with the path of a Fast DDS profile; all releases know the first one."""

FAST_DDS = "rmw_fastrtps_cpp"

DOMAIN, MAX_DOMAIN = "ROS_DOMAIN_ID", 232
"""Variable with the number of the network of nodes, and the highest that has ports."""

PARTICIPANT, NUM_PARTICIPANTS = "FOREGLOW_PARTICIPANT", 30
"""Variable with this process's number in the network, from which our profiles have its ports, and how many there are.

Where it is taken, the next free one is used. A process that is started again needs another number than the one that
died: writers may still send to the memory of that one's port, of which the new process has one of the same name.
"""


def prepare(*, is_networked: bool = False, environment: MutableMapping[str, str] | None = None) -> None:
    """Keeps the nodes on this machine and transports images by shared memory, unless the user has set otherwise.

    Our Fast DDS profile allows only the loopback interface and shared memory, so the discovery range is left to it:
    ROS 2's own `LOCALHOST` would also open sockets on every interface. With a user's profile, or another middleware,
    the discovery range is `LOCALHOST`.

    Args:
        is_networked: Whether nodes on other machines may take part.
        environment: The variables to change; None for those of this process, which must not have loaded rclpy yet.

    Raises:
        FileNotFoundError: If there is no such profile: Fast DDS would open its sockets to every machine then.
        ValueError: If a profile is no XML, the domain or our number in it is none that there can be, or the middleware
            is not there.
    """
    known = os.environ if environment is None else environment
    if environment is None and importlib.util.find_spec("rclpy") is not None:
        for variable in (MIDDLEWARE, ASSERTED):
            if known.get(variable):
                _check_middleware(variable, known[variable])
    domain = known.get(DOMAIN, "").strip()
    if domain and not _is_up_to(MAX_DOMAIN, domain):
        raise ValueError(f"{DOMAIN}: expected a whole number from 0 to {MAX_DOMAIN}, got {domain[:40]!r}")
    takes_profile = known.get(MIDDLEWARE, FAST_DDS) == FAST_DDS and not any(known.get(name) for name in PROFILES)
    if takes_profile:
        name = "fastdds_network.xml" if is_networked else "fastdds_local.xml"
        known[PROFILES[0]] = str(Path(__file__).with_name(name))
    number = known.setdefault(PARTICIPANT, str(os.getpid() % NUM_PARTICIPANTS))
    if not _is_up_to(NUM_PARTICIPANTS - 1, number):  # Fast DDS would pass over the whole profile
        raise ValueError(f"{PARTICIPANT}: expected a whole number below {NUM_PARTICIPANTS}, got {number[:40]!r}")
    if not known.get(RANGE):
        is_local_by_profile = takes_profile and not is_networked
        known[RANGE] = "SUBNET" if is_networked else "SYSTEM_DEFAULT" if is_local_by_profile else "LOCALHOST"
    if known.get(MIDDLEWARE, FAST_DDS) == FAST_DDS:
        for variable in PROFILES:
            if known.get(variable):
                _check_profile(variable, Path(known[variable]))


def _is_up_to(highest: int, text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 9 and int(text) <= highest


def _check_middleware(variable: str, name: str) -> None:
    """Refuses a middleware that is not there: rclpy would end the process without a word as soon as it is loaded."""
    try:
        identify = ctypes.CDLL(f"lib{name}.so").rmw_get_implementation_identifier
        identify.restype = ctypes.c_char_p
        is_there = identify() == name.encode()
    except (OSError, AttributeError):  # no such library, or none of a middleware
        is_there = False
    if not is_there:
        raise ValueError(f"{variable}: expected a middleware that is installed, such as {FAST_DDS}, got {name[:40]!r}")


def _check_profile(variable: str, path: Path) -> None:
    """Refuses a profile that Fast DDS would pass over without a word."""
    if not path.is_file():
        raise FileNotFoundError(f"{variable}: {path}: no such Fast DDS profile; without it, every machine could listen")
    try:
        ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise ValueError(f"{variable}: {path}: expected a Fast DDS profile in XML: {error}") from None
