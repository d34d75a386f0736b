"""Whether a dask scheduler answers at an address, found out within bounds of time and memory."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import struct
import time
from typing import Any

MAX_GREETING_BYTES = 1 << 20
"""Of the first message of a dask process, which has some hundred; it begins with its length."""

_LENGTH = struct.Struct("<Q")
_SPEAK_S = 0.25
"""Of the time for an answer; what is mute for longer than this share is spoken to, such as a server of HTTP."""

_PAUSE_S = 0.1
_TLS = "distributed.comm.tls"
_GARBLED = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, MemoryError, EOFError, struct.error)
"""What dask raises while it reads the answers of something else."""


async def check_scheduler(address: str, timeout_s: float) -> None:
    """Waits for the first answers of a dask scheduler.

    Raises:
        ConnectionError: If none come within the time, or something else answers; the message names `address`.
        ValueError: If it is no address that can be used, or dask's configuration lacks what it needs.
    """
    from distributed.comm.addressing import parse_address, parse_host_port

    scheme, place = parse_address(address)
    try:
        if scheme not in ("tcp", "tls"):
            raise ValueError("it begins with neither tcp:// nor tls://")
        host, port = parse_host_port(place)
        if not 0 < port < 1 << 16:
            raise ValueError(f"there is no port {port}")
    except ValueError as error:
        raise ValueError(f"--cluster: expected an address such as tcp://host:8786, got {address}: {error}") from error
    security = _security(address, is_tls=scheme == "tls")
    try:
        length = await _first_length(host, port, security["ssl_context"] if scheme == "tls" else None, timeout_s)
    except ssl.SSLError as error:
        raise ConnectionError(
            f"--cluster {address}: expected a dask scheduler whose TLS fits the certificates in dask's configuration "
            f"({_TLS}): {error.reason or error}"
        ) from error
    except (OSError, ValueError) as error:  # ValueError: of a host's name
        raise _mute(address) from error
    if length > MAX_GREETING_BYTES:
        raise _foreign(address)
    await _connect(address, security, timeout_s)


def _security(address: str, *, is_tls: bool) -> dict[str, Any]:
    """What dask's connections need by its own configuration."""
    from distributed import Security

    try:
        security: dict[str, Any] = Security().get_connection_args("client")
    except (OSError, ValueError, TypeError) as error:
        reason = str(error) or type(error).__name__
        raise ValueError(f"--cluster {address}: {_TLS} in dask's configuration: {reason}") from error
    if is_tls and security["ssl_context"] is None:
        raise ValueError(
            f"--cluster {address}: expected certificates for TLS in dask's own configuration ({_TLS}: ca-file, "
            "client.cert and client.key), there are none"
        )
    if not is_tls and security["require_encryption"]:
        raise ValueError(
            f"--cluster {address}: expected a tls:// address, as dask's configuration demands encryption "
            "(distributed.comm.require-encryption)"
        )
    return security


async def _first_length(host: str, port: int, context: ssl.SSLContext | None, timeout_s: float) -> int:
    """The length of the first message that comes from there; OSError without one in time."""
    deadline_s = time.monotonic() + timeout_s
    while True:
        try:
            async with asyncio.timeout(deadline_s - time.monotonic()):
                reader, writer = await asyncio.open_connection(host, port, ssl=context)
        except ssl.SSLError:
            raise
        except OSError:
            if time.monotonic() + _PAUSE_S > deadline_s:
                raise
            await asyncio.sleep(_PAUSE_S)  # it may be starting
            continue
        try:
            return await _read_length(reader, writer, deadline_s - time.monotonic())
        finally:
            writer.transport.abort()


async def _read_length(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, timeout_s: float) -> int:
    reading = asyncio.ensure_future(reader.readexactly(_LENGTH.size))
    try:
        await asyncio.wait([reading], timeout=_SPEAK_S * timeout_s)
        if not reading.done():  # a scheduler speaks first
            writer.write(b"\r\n\r\n\r\n\r\n")
        async with asyncio.timeout((1 - _SPEAK_S) * timeout_s):
            (length,) = _LENGTH.unpack(await reading)
            return int(length)
    except asyncio.IncompleteReadError as error:
        if error.partial:  # of another protocol
            return MAX_GREETING_BYTES + 1
        raise ConnectionResetError("closed without a word") from error
    finally:
        reading.cancel()
        with contextlib.suppress(asyncio.CancelledError, asyncio.IncompleteReadError, OSError):
            await reading


async def _connect(address: str, security: dict[str, Any], timeout_s: float) -> None:
    """Has dask shake hands; a `Client` would wait for a mute listener for ever."""
    from distributed.comm.core import connect

    try:
        async with asyncio.timeout(timeout_s):
            comm = await connect(address, timeout=timeout_s, **security)
    except OSError as error:
        raise _mute(address) from error
    except _GARBLED as error:
        raise _foreign(address) from error
    comm.abort()


def _mute(address: str) -> ConnectionError:
    return ConnectionError(f"--cluster {address}: expected a dask scheduler, nothing answers there")


def _foreign(address: str) -> ConnectionError:
    return ConnectionError(f"--cluster {address}: expected a dask scheduler, something else answers there")
