"""``python -m multicell`` and the command ``multicell``, from the first line to the last."""

from __future__ import annotations

import sys


def run() -> None:
    """Run the command; Ctrl-C is answered while its modules are still being loaded, too."""
    try:
        from multicell.cli.main import main

        main(prog_name="multicell")
    except KeyboardInterrupt:
        if sys.stderr is not None:
            sys.stderr.write("Interrupted.\n")
        sys.exit(130)


if __name__ == "__main__":
    run()
