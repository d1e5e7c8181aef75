"""The command ``multicell doctor``."""

from __future__ import annotations

import click

from multicell.cli import options as shared
from multicell.cli.process import print_json
from multicell.cli.tables import key_table


@click.command()
@shared.as_json_option
def doctor(as_json: bool) -> None:
    """Show what there is to run with: versions, cores, memory, cache, missing packages.

    Include it when you report a problem.
    """
    from multicell.host.extras import checkup

    found = checkup()
    if as_json:
        print_json(found)
        return
    rows = {"system": found["system"], "Python": found["python"], **found["versions"]}
    rows["cores"] = f"{found['cores']}, of which multicell uses {found['threads']}"
    if found["memory_GiB"] is not None:
        rows["memory"] = f"{found['memory_GiB']:g} GiB"
    kept = "" if found["cache_writable"] else " (cannot be written to: every command compiles anew)"
    rows["compiled code"] = f"{found['cache']}{kept}"
    for extra, names in found["missing"].items():
        rows[f"extra '{extra}'"] = f'lacks {", ".join(names)}: pip install ".[{extra}]"'
    shared.console().print(key_table(rows.items()))
