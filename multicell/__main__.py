"""``python -m multicell`` and the command ``multicell``, from the first line to the last."""

from __future__ import annotations

import atexit
import os
import sys
import threading
from functools import partial

from multicell.host.call_stack import call_with_room
from multicell.host.garbage import collect_rarely
from multicell.host.interrupts import end_command, watch_command


def run() -> None:
    """Run the command; Ctrl-C is answered while its modules are still being loaded, too."""
    os.environ.setdefault("PYTHONSAFEPATH", "1")  # processes that this one starts
    collect_rarely()
    try:
        watch_command()
        from multicell.cli.main import main

        call_with_room(partial(main, prog_name="multicell"))
    except SystemExit as leaving:
        _end(leaving.code)
        raise
    except KeyboardInterrupt:
        end_command()
        if sys.stderr is not None:
            sys.stderr.write("Interrupted.\n")
        sys.exit(130)


def _end(code: object) -> None:
    """End the process without taking its modules apart, which takes as long as a step or two.

    What is registered for the end is done first. It is left to Python where threads run, somebody
    profiles or has more to type (``python -i``), or a stream cannot be written.
    """
    more = sys.flags.interactive or threading.active_count() > 1
    if not isinstance(code, int) or more or _is_watched():
        return
    atexit._run_exitfuncs()
    try:
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
    except (OSError, ValueError):
        return
    os._exit(code)


def _is_watched() -> bool:
    """Return whether somebody profiles or traces, who has yet to write what has been found."""
    if sys.getprofile() is not None or sys.gettrace() is not None:
        return True
    # from Python 3.12 on, where six tools may watch
    tool = getattr(getattr(sys, "monitoring", None), "get_tool", None)
    return tool is not None and any(tool(number) is not None for number in range(6))


if __name__ == "__main__":
    run()
