"""Workers on this machine obey the process that started them, and no other user."""

import os
import socket
import ssl
import subprocess
import sys

import psutil
import pytest

from multicell.studies.workers import workers

ATTACK = """
import os, sys
from distributed import Client, Security
address = f"{sys.argv[1]}://127.0.0.1:{sys.argv[2]}"
security = Security.temporary() if sys.argv[1] == "tls" else None

def attack():
    with Client(address, timeout=2, security=security) as client:
        client.run_on_scheduler(eval, f"open({sys.argv[3]!r}, 'w').close()")
        client.run(eval, f"open({sys.argv[3]!r}, 'w').close()")
    return "obeyed"

def answer():
    try:
        return attack()
    except OSError:
        return "refused"

answer()  # loads what it needs while it may still read it: Python may be where only its user can
os.setgid(65534)
os.setuid(65534)
print(answer())
"""


@pytest.fixture(scope="module")
def client():
    with workers(2, None) as client:
        yield client


def ports():
    """Return the TCP ports at which this process and those that it started listen."""
    own = psutil.Process()
    found = set()
    for process in (own, *own.children(recursive=True)):
        for entry in process.net_connections("inet"):
            if entry.status == psutil.CONN_LISTEN:
                found.add(entry.laddr.port)
    return sorted(found)


@pytest.mark.slow
@pytest.mark.skipif(getattr(os, "geteuid", lambda: 1)() != 0, reason="only root is two users")
@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_another_user_has_nothing_run(client, protocol, tmp_path):
    assert len(client.nthreads()) == 2
    address = client.scheduler.address
    mark = tmp_path / "mark"
    done = subprocess.run(
        [sys.executable, "-c", ATTACK, protocol, address.rpartition(":")[2], str(mark)],
        cwd="/", capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.stdout.strip() == "refused", done.stderr[-2000:]
    assert not mark.exists()


def answer(port, wrapped):
    """Return the answer of a port to somebody without a certificate who asks for a page."""
    with socket.create_connection(("127.0.0.1", port), timeout=5) as plain:
        plain.settimeout(5)
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        try:
            stream = context.wrap_socket(plain) if wrapped else plain
            stream.sendall(b"GET /info/main/workers.html HTTP/1.0\r\n\r\n")
            return stream.recv(4096)
        except OSError:
            return b""


@pytest.mark.sample("True")
@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.usefixtures("client")
def test_no_port_answers_without_a_certificate(wrapped):
    found = ports()
    assert len(found) >= 5  # a scheduler, two workers and the two that watch over them
    assert {port: answer(port, wrapped) for port in found} == dict.fromkeys(found, b"")


@pytest.mark.slow
def test_workers_of_a_cluster_with_certificates_are_used():
    from distributed import LocalCluster, Security

    with (
        LocalCluster(
            n_workers=1, threads_per_worker=1, security=Security.temporary(), dashboard_address=None
        ) as cluster,
        workers(None, cluster) as client,
    ):
        assert client.submit(sum, [1, 2]).result() == 3
        assert client.scheduler.address.startswith("tls://")
