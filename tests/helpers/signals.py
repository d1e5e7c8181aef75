"""Signals to processes that tests start."""

import signal


def listening():
    """Let a process hear SIGINT; one that a shell starts in the background does not."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
