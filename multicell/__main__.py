"""``python -m multicell`` and the command ``multicell``, from the first line to the last."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from functools import partial

from multicell.host.call_stack import call_with_room
from multicell.host.interrupts import end_command, watch_command

_RARELY = 100_000
"""New objects after which the command's process looks for cyclic garbage. Python's own 700 suit
programs that make it; modules make hundreds of thousands of objects that live on."""


def run() -> None:
    """Run the command; Ctrl-C is answered while its modules are still being loaded, too."""
    os.environ.setdefault("PYTHONSAFEPATH", "1")  # processes that this one starts
    gc.set_threshold(_RARELY, *gc.get_threshold()[1:])
    # Python looks for cyclic garbage among all modules once more before it ends
    atexit.register(gc.freeze)
    try:
        watch_command()
        from multicell.cli.main import main

        call_with_room(partial(main, prog_name="multicell"))
    except KeyboardInterrupt:
        end_command()
        if sys.stderr is not None:
            sys.stderr.write("Interrupted.\n")
        sys.exit(130)


if __name__ == "__main__":
    run()
