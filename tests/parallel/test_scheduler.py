"""What answers at the address of a cluster, and what dask's configuration lacks for it."""

from __future__ import annotations

import contextlib
import re
import shutil
import socket
import struct
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from foreglow.parallel import Cluster
from foreglow.parallel import cluster as cluster_module
from tests.parallel import tasks
from tests.parallel.test_local import nobody

dask = pytest.importorskip("dask")

HTTP = b"HTTP/1.1 400 Bad Request\r\n\r\n"


@contextlib.contextmanager
def answering(at_once: bytes, asked: bytes = b"") -> Iterator[str]:
    """The address of a server that says something at once, and something else when it is spoken to."""

    def serve(server: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = server.accept()
                with contextlib.suppress(OSError), client:
                    client.sendall(at_once)
                    if asked and client.recv(1):
                        client.sendall(asked)
                    while client.recv(4096):
                        pass

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, args=(server,), daemon=True).start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)


def complaint_of(address: str) -> str:
    with pytest.raises((ConnectionError, ValueError)) as caught:
        list(Cluster(address).each(tasks.square, {"a": 1}, nobody))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("at_once", "asked"),
    [
        (b"SSH-2.0-OpenSSH_9.2p1 Debian-2+deb12u3\r\n", b""),
        (b"", HTTP),
        (bytes(range(1, 256)) * 100, b""),
        (struct.pack("<Q", 1 << 62) * 4, b""),
        (struct.pack("<Q", 3 << 30), b""),  # it would fit in memory
        (struct.pack("<QQ", 8, 1 << 60), b""),  # a first message of garbage: a number of frames
        (struct.pack("<QQQ", 16, 1, 1 << 62), b""),
        (struct.pack("<Q", 200) + b"\xc1" * 200, b""),
    ],
    ids=["ssh", "http", "bytes", "huge", "fits", "frames", "huge frame", "garbage"],
)
def test_something_else_answers(monkeypatch: pytest.MonkeyPatch, at_once: bytes, asked: bytes) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 2.0)
    with answering(at_once, asked) as address:
        assert complaint_of(address) == f"--cluster {address}: expected a dask scheduler, something else answers there"


@pytest.mark.parametrize(
    "address",
    [
        "garbage",
        "http://x",
        "tcp://127.0.0.1",
        "tcp://127.0.0.1:99999",
        "tcp://127.0.0.1:-1",
        "ucx://a:1",
        "inproc://x",
    ],
)
def test_no_address(address: str) -> None:
    expected = f"--cluster: expected an address such as tcp://host:8786, got {address}: "
    assert complaint_of(address).startswith(expected)


def test_tls_without_certificates() -> None:
    assert complaint_of("tls://127.0.0.1:8786") == (
        "--cluster tls://127.0.0.1:8786: expected certificates for TLS in dask's own configuration "
        "(distributed.comm.tls: ca-file, client.cert and client.key), there are none"
    )


def test_encryption_that_dask_demands() -> None:
    with dask.config.set({"distributed.comm.require-encryption": True}):
        assert complaint_of("tcp://127.0.0.1:8786").startswith(
            "--cluster tcp://127.0.0.1:8786: expected a tls:// address"
        )


@pytest.fixture
def certificate(tmp_path: Path) -> Path:
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl")
    path = tmp_path / "both.pem"
    command = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -keyout both.pem -out cert.pem"
    subprocess.run(command.split(), cwd=tmp_path, check=True, capture_output=True)
    path.write_bytes(path.read_bytes() + (tmp_path / "cert.pem").read_bytes())
    return path


def test_a_cluster_with_tls(monkeypatch: pytest.MonkeyPatch, certificate: Path) -> None:
    from distributed import LocalCluster
    from distributed.security import Security

    own = Security(
        tls_ca_file=str(certificate),
        **{
            f"tls_{role}_{kind}": str(certificate)
            for role in ("scheduler", "worker", "client")
            for kind in ("cert", "key")
        },
    )
    here = {"processes": False, "protocol": "tls://", "dashboard_address": "127.0.0.1:0", "security": own}
    tls = "distributed.comm.tls"
    settings = {f"{tls}.ca-file": str(certificate), f"{tls}.client.cert": str(certificate)}
    with LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", **here) as cluster:
        with dask.config.set(settings | {f"{tls}.client.key": str(certificate)}):
            assert dict(Cluster(cluster.scheduler_address).each(tasks.square, {"a": 3}, nobody)) == {"a": 9}
        with dask.config.set(settings | {f"{tls}.client.key": str(certificate) + "x"}):
            message = complaint_of(cluster.scheduler_address)
        assert re.match(rf"--cluster tls://127.*: {tls} in dask's configuration: .*No such file", message)
        monkeypatch.setattr(cluster_module, "CONNECT_S", 1.0)
        plain = cluster.scheduler_address.replace("tls", "tcp")
        assert complaint_of(plain).startswith(f"--cluster {plain}: expected a dask scheduler, ")


def test_tls_where_there_is_none(certificate: Path) -> None:
    tls = "distributed.comm.tls"
    settings = {f"{tls}.ca-file": str(certificate), f"{tls}.client.cert": str(certificate)}
    with answering(HTTP) as address, dask.config.set(settings | {f"{tls}.client.key": str(certificate)}):
        message = complaint_of(address.replace("tcp", "tls"))
    assert "expected a dask scheduler whose TLS fits the certificates in dask's configuration" in message
