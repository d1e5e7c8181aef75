"""Schedulers that accept and are silent, or hang later: words within seconds, and Ctrl-C works."""

import os
import signal
import socket
import threading
import time

import pytest
from clusters import Cluster
from studied import CHANGES, runs_of, started, statuses, wait_for

from multicell.errors import ClusterError
from multicell.studies.workers import ANSWER, bounded, workers


@pytest.fixture
def silent():
    """Return the address of a port that accepts everybody and says nothing."""
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        door.listen(20)
        held = []

        def accept():
            while True:
                try:
                    held.append(door.accept())
                except OSError:
                    return

        threading.Thread(target=accept, daemon=True).start()
        yield f"tcp://127.0.0.1:{door.getsockname()[1]}"
        door.shutdown(socket.SHUT_RDWR)


def test_a_scheduler_that_accepts_and_is_silent_is_not_waited_for(silent):
    begin = time.monotonic()
    said = f"does not answer within {ANSWER:g} s"
    with pytest.raises(ClusterError, match=said), workers(None, silent):
        pass
    assert time.monotonic() - begin < 3.0 * ANSWER


def test_a_call_ends_in_time_with_what_it_raises_or_returns():
    assert bounded(lambda: 3, 1.0) == 3
    with pytest.raises(KeyError, match="x"):
        bounded(lambda: {}["x"], 1.0)
    with pytest.raises(TimeoutError, match=r"no answer for 0\.2 s"):
        bounded(threading.Event().wait, 0.2)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="processes cannot be halted here")
def test_ctrl_c_ends_a_study_whose_scheduler_hangs(tmp_path):
    duration = "20 h"
    runs = runs_of(1, changes={**CHANGES, "duration": duration})
    with Cluster(tmp_path) as cluster:
        cluster.worker()
        client = started(tmp_path / "study", 1, cluster.address, duration)
        wait_for(lambda: statuses(runs, tmp_path / "study")[0].state == "running")
        cluster.main.send_signal(signal.SIGSTOP)
        try:
            time.sleep(3.0)  # it is being asked how many workers there are
            begin = time.monotonic()
            os.kill(client.pid, signal.SIGINT)
            text, _ = client.communicate(timeout=60)
            assert (client.returncode, text.splitlines()[-1]) == (130, "Interrupted.")
            assert time.monotonic() - begin < 8.0 * ANSWER
        finally:
            cluster.main.send_signal(signal.SIGCONT)
