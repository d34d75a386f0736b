"""CAN logs: the latest street message, motion, and report of the production system of a car at any time."""

from __future__ import annotations

import math
import threading
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from foreglow.config import read_toml, validated
from foreglow.datasets.vehicle_logs.dbc import check_decoding, check_lengths, check_signal, read_dbc
from foreglow.datasets.vehicle_logs.log_frames import CanKey, read_frames
from foreglow.datasets.vehicle_logs.mapping import CanMapping, NumberSignal, Section
from foreglow.datasets.vehicle_logs.quantities import FACTORS, factor_of, has_both_signs, known_values
from foreglow.datasets.vehicle_logs.street_frames import StreetFrames
from foreglow.files import checked_path
from foreglow.numbers import checked_number
from foreglow.street import StreetMessage
from foreglow.types import EgoMotion
from foreglow.types.arrays import checked_time_ns

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

STREET_STALE_S = 1.0
"""Older street messages are not used."""

MOTION_STALE_S = 0.5
"""Older speeds, yaw rates and reports of the production system are not used."""

RESOLUTION_NS = 1000
"""Logs in text round times to a microsecond: a message that came with a frame may seem to come after it."""

OWN_DBC, OWN_MAPPING = (Path(__file__).with_name(name) for name in ("street.dbc", "street.toml"))

Value = TypeVar("Value")


class Latest(Generic[Value]):
    """Values over time, of which the latest counts, to `RESOLUTION_NS`.

    Attributes:
        times_ns: Their times, never falling.
        values: The values at these times.
        stale_s: A value counts for so long.
    """

    def __init__(self, stale_s: float) -> None:
        self.times_ns: list[int] = []
        self.values: list[Value] = []
        self.stale_s = stale_s

    def add(self, time_ns: int, value: Value) -> None:
        """Adds the latest value."""
        self.times_ns.append(time_ns)
        self.values.append(value)

    def at(self, timestamp_ns: int) -> Value | None:
        """The latest value at or before a time; None where there is none, or it is stale."""
        found = self.with_age(timestamp_ns)
        return None if found is None else found[0]

    def with_age(self, timestamp_ns: int) -> tuple[Value, float] | None:
        """As `at`, with the seconds since then."""
        timestamp_ns = checked_time_ns("timestamp_ns", timestamp_ns)
        index = bisect_right(self.times_ns, timestamp_ns + RESOLUTION_NS) - 1
        if index < 0 or timestamp_ns - self.times_ns[index] > self.stale_s * 1e9:
            return None
        return self.values[index], max(timestamp_ns - self.times_ns[index] - RESOLUTION_NS, 0) / 1e9

    def forget(self, before_ns: int) -> None:
        """Drops the values before a time."""
        num_old = bisect_left(self.times_ns, before_ns)
        del self.times_ns[:num_old], self.values[:num_old]


class CanLog:
    """What a car sent on its bus over time; a thread may add to it while another one reads.

    Attributes:
        first_ns: Time of the first value; 0 while it is empty.
        last_ns: Time of the last value.
        has_street: Whether it has a whole street message.
        is_empty: Whether it has no value.
        tells_speed: Whether it is a log of the speed, also while it has none.
    """

    def __init__(self, keep_s: float = math.inf) -> None:
        """An empty log, which drops values that are older than the last by more than `keep_s`."""
        keep_s = checked_number("keep_s", keep_s)
        if not keep_s >= 0:
            raise ValueError(f"keep_s: expected a number of seconds of at least 0, got {keep_s}")
        self._keep_ns = 1e9 * keep_s
        self._streets = Latest[StreetMessage | None](STREET_STALE_S)
        self._numbers = {name: Latest[float](MOTION_STALE_S) for name in ("speed", "yaw_rate", "production")}
        self._lock = threading.Lock()
        self.first_ns = self.last_ns = 0
        self.has_street, self.is_empty, self.tells_speed = False, True, False

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())

    def add_street(self, time_ns: int, message: StreetMessage | None) -> None:
        """Adds the road at the latest position, None for an unknown position; times must not fall."""
        self.has_street |= message is not None
        self._add(self._streets, time_ns, message)

    def add_number(self, quantity: str, time_ns: int, value: float) -> None:
        """Adds a `speed` in m/s, a `yaw_rate` in rad/s, or what `production` reports; times must not fall."""
        self._add(self._numbers[quantity], time_ns, value)

    def has(self, quantity: str) -> bool:
        """Whether there is a value of the quantity that `add_number` names."""
        return bool(self._numbers[quantity].times_ns)

    def street(self, timestamp_ns: int) -> StreetMessage | None:
        """The street message of the latest position at or before a time; None if it is stale or unknown."""
        found = self.street_with_age(timestamp_ns)
        return None if found is None else found[0]

    def street_with_age(self, timestamp_ns: int) -> tuple[StreetMessage, float] | None:
        """As `street`, with the seconds since the position was sent."""
        with self._lock:
            found = self._streets.with_age(timestamp_ns)
        return None if found is None or found[0] is None else (found[0], found[1])

    def motion(self, timestamp_ns: int) -> EgoMotion | None:
        """The latest speed and yaw rate at or before a time; None if either is stale or missing."""
        speed_mps, yaw_rate_radps = self._number("speed", timestamp_ns), self._number("yaw_rate", timestamp_ns)
        if speed_mps is None or yaw_rate_radps is None:
            return None
        return EgoMotion(speed_mps, yaw_rate_radps)

    def is_reported(self, timestamp_ns: int) -> bool | None:
        """Whether the production system reports a vehicle, by its latest message; None if that is stale or missing."""
        number = self._number("production", timestamp_ns)
        return None if number is None else number > 0

    def _number(self, quantity: str, timestamp_ns: int) -> float | None:
        with self._lock:
            return self._numbers[quantity].at(timestamp_ns)

    def _add(self, latest: Latest[Value], time_ns: int, value: Value) -> None:
        with self._lock:
            self.first_ns = time_ns if self.is_empty else min(self.first_ns, time_ns)
            self.last_ns = time_ns if self.is_empty else max(self.last_ns, time_ns)
            self.is_empty = False
            latest.add(time_ns, value)
            if math.isfinite(self._keep_ns):
                latest.forget(time_ns - round(self._keep_ns))


def read_can_log(path: Path | str, dbc: Path | str | None = None, mapping: Path | str | None = None) -> CanLog:
    """The CAN log in the file `path`: Vector's .asc or .blf, or candump's .log.

    The times of .asc count from its start. Frames that the mapping does not name are ignored, and so are multiplexed
    frames without its signals.

    Args:
        path: The log.
        dbc: Description of the frames; None for our own, as `write_can_log` writes them.
        mapping: Meaning of its signals; goes with `dbc`.

    Raises:
        FileNotFoundError: If there is no such file.
        ModuleNotFoundError: If cantools or python-can is not installed (extra `can`).
        ValueError: If a file is broken, the log's times jump back, the mapping names something that the DBC does not
            have, the log has none of its frames, or only one of speed and yaw rate.
    """
    path = checked_path(path)
    decoder = CanDecoder(dbc, mapping)
    for time_ns, key, data in sorted(read_frames(path, decoder.keys, decoder.bus), key=lambda frame: frame[0]):
        decoder.take(time_ns, key, data, f"{path}: frame at {time_ns / 1e9:.6f} s")
    of_bus = f" on bus {decoder.bus}" if decoder.bus is not None else ""
    if decoder.log.is_empty:
        names = ", ".join(decoder.message_names)
        raise ValueError(f"{path}: expected frames of {names}{of_bus}, with values, got none")
    missing = {name: message for name, message in decoder.motion.items() if not decoder.log.has(name)}
    if len(missing) == 1:
        ((name, message),) = missing.items()
        raise ValueError(f"{path}: expected frames of {message}{of_bus} with a value of {name}, got none")
    return decoder.log


def read_mapping(path: Path) -> CanMapping:
    """The mapping in the TOML file `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or a field is missing or unknown.
    """
    return validated(CanMapping, read_toml(path), str(path))


class CanDecoder:
    """Turns frames into a log, by a DBC and a mapping of its signals.

    Attributes:
        log: The log of the frames so far.
    """

    def __init__(
        self, dbc: Path | str | None = None, mapping: Path | str | None = None, *, keep_s: float = math.inf
    ) -> None:
        """Reads both files; None for our own.

        Args:
            dbc: Description of the frames.
            mapping: Meaning of its signals; goes with `dbc`.
            keep_s: Values are kept for so long.

        Raises:
            FileNotFoundError: If there is no such file.
            ModuleNotFoundError: If cantools is not installed (extra `can`).
            ValueError: If a file is broken, or the mapping names something that the DBC does not have, or that nobody
                could decode.
        """
        if (dbc is None) != (mapping is None):
            raise ValueError(f"{dbc or mapping}: expected a DBC and a mapping together, got one of them")
        dbc = OWN_DBC if dbc is None else checked_path(dbc, "dbc")
        mapping = OWN_MAPPING if mapping is None else checked_path(mapping, "mapping")
        self.log = CanLog(keep_s)
        messages = read_dbc(dbc)
        self._mapping = read_mapping(mapping)
        self.log.tells_speed = self._mapping.speed is not None
        self._street_frames = StreetFrames(self._mapping)
        self._sections: dict[CanKey, tuple[Message, list[tuple[str, dict[str, str]]]]] = {}
        self._factors: dict[str, float] = {}
        self._quantities: dict[CanKey, frozenset[str]] = {}  # the signals that are numbers with a unit
        for name, section in self._mapping.sections():
            if section.message not in messages:
                known = ", ".join(sorted(messages)[:20])
                raise ValueError(
                    f"{mapping}: {name}.message: expected a message of {dbc}, such as {known}, got {section.message!r}"
                )
            message = messages[section.message]
            signals = {signal.name: signal for signal in message.signals}
            for field, name_in_dbc in section.signals().items():
                if name_in_dbc not in signals:
                    raise ValueError(
                        f"{mapping}: {name}.{field}: expected a signal of {section.message}, such as "
                        f"{', '.join(sorted(signals)[:20])}, got {name_in_dbc!r}"
                    )
                check_signal(signals[name_in_dbc], f"{dbc}: {message.name}: {name_in_dbc}")
            check_lengths(message, str(dbc))
            check_decoding(message, str(dbc))
            _check_signs(section, signals, f"{mapping}: {name}", f"{dbc}: {message.name}")
            key = message.frame_id, message.is_extended_frame
            first, own = self._sections.setdefault(key, (message, []))
            if first.name != message.name:
                raise ValueError(
                    f"{dbc}: expected an identifier of its own for each message of the mapping, {first.name} and "
                    f"{message.name} have {message.frame_id:X}"
                )
            own.append((name, section.signals()))
            if isinstance(section, NumberSignal):
                signal, factor = signals[section.signal], section.factor
                if name in FACTORS:
                    origins = f"{mapping}: {name}.factor", f"{dbc}: {message.name}: {signal.name}"
                    factor = factor_of(name, signal, factor, origins)
                    self._quantities[key] = self._quantities.get(key, frozenset()) | {signal.name}
                self._factors[name] = 1.0 if factor is None else factor

    @property
    def bus(self) -> str | None:
        """The bus that the mapping names, in a log of several; None if it names none."""
        return self._mapping.bus

    @property
    def keys(self) -> Collection[CanKey]:
        """Keys of the frames that it decodes."""
        return self._sections.keys()

    @property
    def message_names(self) -> list[str]:
        """Names of the messages that it decodes."""
        return [message.name for message, _ in self._sections.values()]

    @property
    def motion(self) -> dict[str, str]:
        """The messages of `speed` and `yaw_rate`, which a motion needs both; empty if it decodes neither."""
        return {name: part.message for name, part in self._mapping.sections() if name in ("speed", "yaw_rate")}

    def take(self, time_ns: int, key: CanKey, data: bytes, where: str) -> None:
        """Adds the values of a frame to the log; frames must come in the order of time, and be among `keys`.

        Raises:
            ValueError: If the frame is not as the DBC says; the message begins with `where`.
        """
        message, sections = self._sections[key]
        try:
            decoded = _decoded(message, data, where, self._quantities.get(key, frozenset()))
            for name, signals in sections:
                if all(signal in decoded for signal in signals.values()):
                    self._add(time_ns, name, {field: decoded[signal] for field, signal in signals.items()})
        except OverflowError as error:
            raise ValueError(f"{where}: {message.name}: expected numbers that can be computed with: {error}") from None

    def _add(self, time_ns: int, section: str, values: dict[str, float]) -> None:
        if section == "segment":
            self._street_frames.add_segment(values, time_ns)
        elif section == "slope":
            self._street_frames.add_slope(values)
        elif section == "position":
            self.log.add_street(time_ns, self._street_frames.message(values, time_ns))
        else:
            self.log.add_number(section, time_ns, _number(values, self._factors.get(section, 1.0)))


def _check_signs(section: Section, signals: Mapping[str, Signal], field: str, origin: str) -> None:
    """ValueError if a number of either sign comes as a signal of one sign, without another that says which it has."""
    for number, sign in section.SIGNS.items():
        name = getattr(section, number)
        if name is not None and getattr(section, sign) is None and not has_both_signs(signals[name]):
            raise ValueError(
                f"{field}.{sign}: expected the signal that has the sign of {name}, got none, and by {origin} {name} "
                "is never below 0, or never above it: all would be of one sign"
            )


def _decoded(message: Message, data: bytes, where: str, quantities: frozenset[str]) -> dict[str, float]:
    """The finite signals of a frame that are known; a multiplexed frame has only some of them."""
    import cantools

    try:
        decoded = message.decode(data, decode_choices=False)
    except cantools.Error as error:
        if message.is_multiplexed() and len(data) >= message.length:
            return {}  # of a number that the DBC does not have: nothing else of such a frame can be wrong
        raise ValueError(f"{where}: {message.name}: {error}") from None
    raw: Any = message.decode(data, decode_choices=False, scaling=False)
    known = known_values(message, cast("dict[str, Any]", decoded), raw, quantities)
    return {name: float(value) for name, value in known.items() if math.isfinite(value)}


def _number(values: dict[str, float], factor: float) -> float:
    value = values["signal"]
    return factor * (-abs(value) if values.get("is_negative") else value)
