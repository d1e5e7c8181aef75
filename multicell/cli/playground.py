"""Server of ``multicell play``: one page, the run for its sliders, and the view of that run.

The server listens on the loopback device. Each request needs the secret of the address, and the
name of this machine as its host and, where the browser states one, its origin, so that no page of
another origin reaches it. The secret is in no argument of a process and in no log.
"""

from __future__ import annotations

import asyncio
import hmac
import io
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, final

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from tornado.httpserver import HTTPServer
from tornado.log import app_log
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from multicell.errors import MulticellError, OutputError
from multicell.report.html import rendered, script
from multicell.report.result import Result, load_result
from multicell.report.wording import cell_count, time_unit, written
from multicell.results.folder import file_errors
from multicell.scene.coarsening import coarsen
from multicell.schema import leaves

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.studies.axes import Range

HOST: Final = "127.0.0.1"
KEPT: Final = 5
"""Runs that are kept, to compare their curves."""
_ROOM: Final = b"\n" * 4096
"""Lines for what a run says at its end: on a disk that it has filled there is no room for more."""


@final
class Playground:
    """The runs of a page, one at a time, in a folder that goes with it.

    - ``factor``: by which cells are wider than those of the scene; ``note`` is on that
    - ``laws``: FILE:NAME of each law of the user's own that the scene needs
    - ``units``: key of a range -> unit of its labels, and how many base units that is; by default
      hours for times, base units for others
    """

    def __init__(
        self,
        scene: Scene,
        ranges: Sequence[Range],
        factor: float,
        note: str,
        laws: Sequence[str] = (),
        *,
        units: Mapping[str, tuple[str, float]] | None = None,
    ) -> None:
        self._units = units or {}
        self.scene, self.ranges, self.factor, self.note = scene, ranges, factor, note
        self._laws = [word for law in laws for word in ("--law", law)]
        with file_errors("make a folder in", Path(tempfile.gettempdir())):
            self._folder = Path(tempfile.mkdtemp(prefix="multicell-play-"))
        self._worker: subprocess.Popen[bytes] | None = None
        self._labels: dict[int, str] = {}
        self._duration = scene.duration
        self.number = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        shutil.rmtree(self._folder, ignore_errors=True)

    def door(self, address: str) -> Path:
        """Return a page that only this user may read, and that leads to an address."""
        page = self._folder / "open.html"
        page.touch(mode=0o600)
        page.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', "utf-8")
        return page

    def sliders(self) -> list[dict[str, Any]]:
        """Return the data of each slider for the page; places are from 0 to 1000."""
        found = []
        for item, share in zip(self.ranges, self._shares(), strict=True):
            place = round(1000.0 * share)
            unit, factor = self._unit(item)
            found.append(
                {
                    "key": item.key,
                    "low": item.low / factor,
                    "high": item.high / factor,
                    "log": item.log,
                    "whole": item.whole,
                    "unit": written(unit),
                    "place": place,
                }
            )
        return found

    def _shares(self) -> list[float]:
        """Return where the scene's values lie in the ranges; in the middle where they do not."""
        given = {".".join(path): value for path, value, _ in leaves(self.scene)}
        values = [given.get(item.key) for item in self.ranges]
        return [
            item.share(value)
            if isinstance(value, int | float) and item.low <= value <= item.high
            else 0.5
            for item, value in zip(self.ranges, values, strict=True)
        ]

    def _unit(self, item: Range) -> tuple[str, float]:
        usual = ("h", 3600.0) if item.unit == "s" else (item.unit, 1.0)
        return self._units.get(item.key, usual)

    def _label(self, item: Range, value: float) -> str:
        unit, factor = self._unit(item)
        return f"{value / factor:.3g} {written(unit)}".strip()

    def begin(self) -> int:
        """Begin a run of the scene as it is; return its number."""
        return self.start([1000.0 * share for share in self._shares()])

    def start(self, places: Sequence[float]) -> int:
        """Begin a run where the sliders stand; return its number.

        Raises SceneError for values that do not go together.
        """
        shares = [float(place) / 1000.0 for place in places]
        if len(shares) != len(self.ranges) or not all(0.0 <= share <= 1.0 for share in shares):
            raise OutputError("the page and its server do not belong together: load it anew")
        values = [item.value(share) for item, share in zip(self.ranges, shares, strict=True)]
        changes = {x.key: x.setting(v) for x, v in zip(self.ranges, values, strict=True)}
        scene = self.scene.with_changes(changes)
        if self.factor != 1.0:
            scene = coarsen(scene, self.factor)
        self.stop()
        number = self.number + 1
        file, log = self._folder / "scene.toml", self._folder / "log"
        with file_errors("use the folder of the runs", self._folder):
            for old in [one for one in self._labels if one <= number - KEPT]:
                del self._labels[old]
                shutil.rmtree(self._folder / str(old), ignore_errors=True)
            file.write_text(scene.to_toml(), "utf-8")
            log.write_bytes(_ROOM)
        self.number, self._duration = number, scene.duration
        self._labels[number] = f"{number}: " + ", ".join(
            self._label(item, value) for item, value in zip(self.ranges, values, strict=True)
        )
        place = str(self._folder / str(number))
        command = [sys.executable, "-m", "multicell", "run", str(file), "-o", place, *self._laws]
        with log.open("r+b") as said:
            self._worker = subprocess.Popen(
                [*command, "--no-report", "--quiet"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,
            )
        return self.number

    def stop(self) -> None:
        """End the run that is going on, with the processes that it has started."""
        worker, self._worker = self._worker, None
        if worker is None or worker.poll() is not None:
            return
        if os.name == "posix":
            os.killpg(worker.pid, signal.SIGTERM)
        else:
            worker.terminate()
        try:
            worker.wait(10.0)
        except subprocess.TimeoutExpired:
            worker.kill()
            worker.wait()

    def result(self, number: int | None = None) -> Result | None:
        """Return a run as far as it is, by default the newest; None before its first frame."""
        try:
            found = load_result(self._folder / str(number or self.number))
        except OutputError:
            return None
        return found if len(found.frames) else None

    def status(self) -> dict[str, Any]:
        """Return how far the newest run is."""
        code = None if self._worker is None else self._worker.poll()
        going = self._worker is not None and code is None
        result = self.result()
        known = {"number": self.number, "going": going, "frames": 0, "part": 0.0, "text": ""}
        if self._worker is not None and code:
            said = (self._folder / "log").read_text("utf-8", "replace").strip().splitlines()
            return {**known, "text": said[-1] if said else f"The run ended with code {code}."}
        if result is None:
            return {**known, "text": "The run begins ..." if going else ""}
        last = result.frames[-1]
        unit = time_unit(self._duration)
        words = [unit.text(last.time), cell_count(len(last.cells))]
        if not going:
            words.append("done" if code == 0 else "stopped")
        words.append(verdict(result.history))
        part = last.time / self._duration
        return {**known, "frames": len(result.frames), "part": part, "text": " · ".join(words)}

    def curves(self, dark: bool = False) -> bytes:
        """Return the curves of all kept runs as a PNG, in the colours of light or dark mode."""
        from multicell.report.plots.dark import darken
        from multicell.report.plots.growth import overlay

        found = {label: self.result(number) for number, label in self._labels.items()}
        shown = {label: run.history for label, run in found.items() if run is not None}
        if not shown:
            raise OutputError("there is no run yet")
        picture = io.BytesIO()
        figure = overlay(shown, "diameter")
        if dark:
            darken(figure)
        figure.savefig(picture, dpi=130)
        return picture.getvalue()

    def page(self) -> str:
        """Return the page."""
        sliders = self.sliders()
        return rendered(
            "play.html",
            title=self.scene.title or "Untitled scene",
            subtitle=self.note,
            sliders=sliders,
            **script("play.js"),
            about=Markup(json.dumps(sliders).replace("<", "\\u003c")),
        )

    def view(self) -> str:
        """Return the view of the newest run."""
        from multicell.report.viewer.pack import pack_view

        result = self.result()
        viewer = None if result is None else pack_view(result)
        if viewer is None:
            raise OutputError("there is no frame yet")
        return rendered("view.html", title="", viewer=viewer)


def verdict(history: Mapping[str, NDArray[np.float64]]) -> str:
    """Return one sentence on a run: quiescence and death, or else growth."""
    time = history["time"]
    for state, onset in (("necrotic", "necrosis"), ("quiescent", "quiescence")):
        if state in history and (some := np.flatnonzero(history[state] > 0)).size:
            return f"{onset} begins {_when(time[some[0]], time[-1])}"
    first, last = history["cells"][[0, -1]]
    if last > first > 0:
        times = last / first
        many = f"{times:,.0f}" if times >= 100.0 else f"{times:.3g}"
        return f"{many} times as many cells, none quiescent or necrotic"
    return (
        "no growth, no cell quiescent or necrotic" if first == last else "fewer cells than at first"
    )


def _when(time: float, end: float) -> str:
    if time <= 0.0:
        return "at the start"
    unit = time_unit(end)
    return f"on day {time // 86400.0 + 1:.0f}" if unit.name == "d" else f"after {unit.text(time)}"


@final
class _Handler(RequestHandler):
    """Answer those who know the secret."""

    def initialize(self, playground: Playground, secret: str, hosts: Sequence[str]) -> None:
        self.playground, self._secret, self._hosts = playground, secret, hosts

    def prepare(self) -> None:
        """Refuse who does not know the secret, or calls this machine by another name."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("Content-Security-Policy", "frame-ancestors 'self'")
        self.set_header("Referrer-Policy", "no-referrer")
        given = self.get_query_argument("token", "")
        known = hmac.compare_digest(given.encode(), self._secret.encode())
        origin = self.request.headers.get("Origin")
        foreign = origin is not None and origin not in [f"http://{host}" for host in self._hosts]
        if not known or foreign or self.request.host not in self._hosts:
            raise HTTPError(403)

    def log_exception(self, typ: Any, value: Any, tb: Any) -> None:
        """Log what is not foreseen by the path of the request alone: the rest holds the secret."""
        if not isinstance(value, HTTPError):
            app_log.error(
                "%s %s", self.request.method, self.request.path, exc_info=(typ, value, tb)
            )

    def get(self, what: str) -> None:
        if what == "curves":
            self.set_header("Content-Type", "image/png")
        dark = {"dark": True} if what == "curves" and self.get_query_argument("dark", "") else {}
        answers = {"": "page", "view": "view", "curves": "curves", "run": "status"}
        try:
            answer = getattr(self.playground, answers[what])(**dark)
        except OutputError:  # there is nothing to see yet
            raise HTTPError(404) from None
        self.finish(answer)

    def post(self, _: str) -> None:
        try:
            self.finish({"number": self.playground.start(json.loads(self.request.body)["places"])})
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            raise HTTPError(400) from None
        except MulticellError as error:
            self.set_status(422)
            self.finish({"text": str(error)})

    def delete(self, _: str) -> None:
        self.playground.stop()
        self.finish(self.playground.status())


def serve(playground: Playground, port: int, ready: Callable[[str], None]) -> None:
    """Serve a playground until Ctrl-C or a signal to end; ``ready`` is called with the address."""

    async def serving() -> None:
        try:
            sockets = bind_sockets(port, HOST)
        except OSError as error:
            raise OutputError(f"port {port} cannot be used: {error.strerror}") from None
        number, secret = sockets[0].getsockname()[1], secrets.token_urlsafe(24)
        hosts = [f"{name}:{number}" for name in (HOST, "localhost")]
        known = {"playground": playground, "secret": secret, "hosts": hosts}
        routes = [("/(|view|curves|run)", _Handler, known)]
        quiet = Application(routes, log_function=lambda _: None)  # a log would hold the secret
        server = HTTPServer(quiet, max_body_size=10_000)
        server.add_sockets(sockets)
        ready(f"http://{HOST}:{number}/?token={secret}")
        await asyncio.Event().wait()

    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, ended)
    try:
        asyncio.run(serving())
    except KeyboardInterrupt:
        playground.stop()
