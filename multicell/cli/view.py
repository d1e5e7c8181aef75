"""The command ``multicell view``: a run's page in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click

from multicell.cli.options import as_json_option, loaded_law_option
from multicell.cli.process import complain, print_file


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--no-browser", is_flag=True, help="Write the page, and do not open it.")
@loaded_law_option
@as_json_option
def view(folder: Path, no_browser: bool, as_json: bool) -> None:
    """Open the page of the run in FOLDER, also while it goes on: with all frames so far.

    The page is written anew unless it is younger than the results.
    """
    page = folder / "report.html"
    if not _up_to_date(page, folder):
        from multicell.report.result import load_result

        page = load_result(folder).report()
    if not no_browser and not webbrowser.open(page.resolve().as_uri()):
        complain("There is no browser to open it.")
    print_file(page, as_json)


def _up_to_date(page: Path, folder: Path) -> bool:
    from multicell.results.folder import PASSING, file_errors

    with file_errors("read", folder):
        if not page.is_file():
            return False
        results = [folder / name for name in ("frames.h5", "summary.json", *PASSING)]
        written = page.stat().st_mtime_ns
        return all(path.stat().st_mtime_ns <= written for path in results if path.exists())
