"""``python -m multicell`` and the command ``multicell``, from the first line to the last."""

from __future__ import annotations

import os
import sys
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
    except KeyboardInterrupt:
        end_command()
        if sys.stderr is not None:
            sys.stderr.write("Interrupted.\n")
        sys.exit(130)


if __name__ == "__main__":
    run()
