"""Checks that every scene must pass, and processes that try it with many.

A case is a dict of a scene. :func:`load_case` and :func:`run_case` return what became of it, or
raise :class:`Fault`. :func:`campaign` draws cases in processes of their own and returns a
:class:`Tally` with all faults.
"""

from __future__ import annotations

import collections
import contextlib
import fnmatch
import json
import pickle
import re
import tempfile
import time as clock
import traceback
import tracemalloc
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from multicell.results.measures import NO_CENTRE
from multicell.results.quantities import ABSENT_WORDS

_AT_THE_START = re.compile("nodes|finite medium of .* its grid covers|too far|origin, where")
_NUMBER = re.compile(r"-?\d[\d.e+-]*")
SECONDS_TO_LOAD = 8.0
BYTES_TO_LOAD = 100e6
SECONDS_TO_RUN = 180.0
"""Compilation of a law and a method that no case had before included, on a slow machine."""
REMAINDER = 1e-6
"""Of an account, over what passed or was there."""
ENDLESS = {"cycle_time"}
"""Columns that are documented to be infinite: nothing grows, no cycle ends."""


UNKNOWN_OF_LIVING = ("death_time", "end_time")
"""Columns that are not a number of those who have not died, or are there to the end."""


class Fault(Exception):  # noqa: N818 - what was found, not a failure of the harness
    """Something that must never be; the text begins with its kind."""


# --- loading -----------------------------------------------------------------------------------


def load_case(entries):
    """Load a scene from a dict and as TOML; return ``"loaded"`` or ``"refused"``."""
    from multicell.scene.scene import Scene

    tracemalloc.start()
    try:
        begin = clock.process_time()
        # a table of cells is looked for beside the file of a scene, or in the working directory
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            made = _made(lambda: Scene.from_dict(entries), entries)
            _load_text(entries, made, Path.cwd() / "scene.toml")
        if isinstance(made, Scene):
            _round_trips(made)
        seconds, (_, peak) = clock.process_time() - begin, tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    if seconds > SECONDS_TO_LOAD:
        raise Fault(f"slow: {seconds:.1f} s")
    if peak > BYTES_TO_LOAD:
        raise Fault(f"memory: {peak / 1e6:.0f} MB")
    if not isinstance(made, Scene) or _refused_late(made) or _refused_at_the_start(made, entries):
        return "refused"
    return "loaded"


def start_of(entries):
    """Return whether a scene ``"begins"``, or is ``"refused"`` where it is read or explained."""
    from multicell.scene.scene import Scene

    made = _made(lambda: Scene.from_dict(entries), entries)
    refused = not isinstance(made, Scene) or _refused_at_the_start(made, entries)
    return "refused" if refused else "begins"


def _refused_at_the_start(scene, entries):
    """Return whether ``explain`` refuses a scene whose run could not begin, by a place in it."""
    from multicell.errors import SceneError

    try:
        explained(scene)
    except SceneError as error:
        if not (place_exists(error.path, entries) and error.problem):
            raise Fault(f"path: {error.path!r} is no place in the scene: {error}") from error
        return True
    return False


def _refused_late(scene):
    """Return whether the table that a scene starts with is refused where it is first read.

    A scene that knows digest and rows of its table loads without the file.
    """
    from multicell.errors import DataError, SceneError

    if scene.initial.cells is None or scene.initial.cells.at_hand:
        return False
    try:
        return not scene.initial.cells.given
    except SceneError as error:
        if not (error.path.startswith("initial.cells.") and error.problem):
            raise Fault(f"path: {error.path!r} of a table: {error}") from error
        return True
    except DataError as error:
        return _named(error)


def _named(error):
    if not (error.place and error.problem):
        raise Fault(f"words: nowhere, or no problem: {error}") from error
    return True


def _made(make, entries):
    """Return the scene, or the text of the error that names the place."""
    from multicell.errors import DataError, SceneError

    try:
        return make()
    except SceneError as error:
        if not place_exists(error.path, entries):
            raise Fault(f"path: {error.path[:80]!r} is no place in the scene: {error}") from error
        if not error.problem:
            raise Fault(f"words: no problem at {error.path!r}") from error
        return str(error)
    except DataError as error:  # of the table that the scene starts with
        return _named(error) and str(error)


def _load_text(entries, made, file):
    """Write the entries as TOML, where TOML can; load_scene must say the same as from_dict."""
    import tomli_w

    from multicell.scene.scene import load_scene

    try:
        content = tomli_w.dumps(entries)
    except (AttributeError, TypeError, ValueError, RecursionError):
        return  # no TOML: None, bytes, keys that are no text, endless integers
    try:
        file.write_text(content, encoding="utf-8")
    except UnicodeEncodeError:
        return
    again = _made(lambda: load_scene(file), entries)
    # where several places are wrong, the order of the tables decides which is named
    if type(again) is not type(made) or (again != made and not isinstance(made, str)):
        raise Fault(f"text: from TOML {again}, from the dict {made}")


def _round_trips(scene):
    """Check that a scene comes back from its dict, its TOML text and no changes as it was."""
    import tomllib

    from multicell.scene.scene import Scene, load_scene

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.toml"
        file.write_text(scene.to_toml(), encoding="utf-8")
        assert tomllib.loads(file.read_text(encoding="utf-8")) == scene.to_dict()
        others = [load_scene(file), Scene.from_dict(scene.to_dict()), scene.with_changes({})]
    for other in others:
        same = other == scene and hash(other) == hash(scene) and other.to_toml() == scene.to_toml()
        if not same:
            raise Fault(f"round trip: {scene} came back as {other}")


def place_exists(path, entries):
    """Return whether a dotted path leads to a place in entries, or to one that may be there."""
    from multicell.scene.scene import Scene

    if not path:
        return not isinstance(entries, dict) or not all(isinstance(key, str) for key in entries)
    return _leads(path, entries, Scene)


def _leads(path, node, part):
    from multicell.schema import specs

    known = {} if part is None else specs(part)
    here = list(node) if isinstance(node, dict) else []
    for key in {*(k or "''" for k in here if isinstance(k, str)), *known}:
        if path == key:
            return True
        if path.startswith(f"{key}."):
            spec = known.get(key)
            rest = path[len(key) + 1 :]
            below = node.get(key) if isinstance(node, dict) else None
            if spec is None:
                return _leads(rest, below, part)
            if spec.parts is not None:
                tables = [spec.key, *(k for p in spec.parts.values() for k in specs(p))]
                return rest in tables or _leads(rest, below, None)
            if spec.kind in ("table", ""):
                return rest == spec.shorthand or _leads(rest, below, spec.table)
            name, _, tail = rest.partition(".")
            entry = below.get(name) if isinstance(below, dict) else None
            missing = name in spec.options or spec.kind in ("quantities", "responses")
            if entry is None and not missing and not (isinstance(below, dict) and rest in below):
                return False
            return not tail or rest in (below or {}) or _leads(tail, entry, spec.table)
    return False


def explained(scene, **options):
    """Return the text of ``explain``, which must be plain and finite, or end by name."""
    from multicell.report.explain.scene import explain

    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        told = explain(scene, **options)
    json.dumps(told)
    for number in told["numbers"]:
        value = number["value"]
        if not np.isfinite(value) and "infinite" not in number["meaning"]:
            raise Fault(f"explain: {number['name'].split(',')[0]} is {value}")
    return told


# --- running -----------------------------------------------------------------------------------


def run_case(entries):
    """Run a scene to its end; return ``"ran"``, ``"refused"`` or the name of its failure."""
    from multicell.errors import DataError, SceneError, StepFailed
    from multicell.runner import run
    from multicell.scene.scene import Scene

    try:
        scene = Scene.from_dict(entries)
    except (SceneError, DataError):
        return "refused"
    if _refused_late(scene) or _refused_at_the_start(scene, entries):
        return "refused"
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            result = run(scene, threads=1)
        except SceneError as error:
            raise Fault(f"start: explained, then refused at {error.path}: {error}") from error
        except StepFailed as error:
            if error.time == 0.0 and _AT_THE_START.search(error.problem):
                raise Fault(f"start: explained, then failed at its beginning: {error}") from error
            return f"StepFailed ({_NUMBER.sub('#', error.problem)[:60]})"
    check_result(result)
    check_tables(result)
    return "ran"


def check_tables(result):
    """Raise :class:`Fault` for a number that is none in what a run exports."""
    from multicell.report.tables import TABLES

    for name, make in TABLES.items():
        for part in make(result, iter(enumerate(result.frames))):
            for title, column in part.items():
                plain = title.removeprefix("history.")
                known = [
                    k for k in ENDLESS | set(ABSENT_WORDS) if fnmatch.fnmatchcase(plain, f"{k}*")
                ]
                living = plain.startswith(UNKNOWN_OF_LIVING)
                finite = column[~np.isnan(column)] if living else column
                _finite(f"table {name}.{title}", finite, known[0] if known else title)


def check_result(result):
    """Raise :class:`Fault` for a number that is none, an open ledger, cells lost or made."""
    for name, column in result.history.items():
        _finite(f"history.{name}", column, name)
        domain = result.scene.domain
        if ABSENT_WORDS.get(name) == NO_CENTRE and not (domain and domain.periodic):
            _finite(f"history.{name}", column, "of a population that has a centre")
    for frame in result.frames:
        _check_frame(frame)
    summary = result.summary()
    _walk("summary", summary)
    for name, ledger in summary["ledger"].items():
        if name != "relative_remainder" and not ledger["relative_remainder"] <= REMAINDER:
            raise Fault(f"ledger: {name} is left open by {ledger['relative_remainder']:.3g}")
    _check_numbers(result, summary)
    _check_start(result, summary)
    _check_next_start(result)


def _check_start(result, summary):
    """Check that nobody lives at the start who cannot live with what the cells leave."""
    scene, first = result.scene, result.frames[0]
    table, death = scene.initial.cells, scene.death
    given = table is not None and "state" in table.given.columns
    slow = death is not None and (death.necrosis_rate or death.damage_time) is not None
    if first.step or given or slow:
        return
    short = np.zeros(len(first.cells), bool)
    for name, field_ in scene.nutrients.items():
        c = first.concentrations[name]
        short |= c < (field_.necrosis or 0.0)
        short |= c > (np.inf if field_.necrosis_above is None else field_.necrosis_above)
    number = int((short & ~first.cells.dead).sum())
    if number > summary.get("start", {}).get("unfit", 0):
        raise Fault(f"start: {number} cells live where they cannot")


def _check_next_start(result):
    """Check that the scene accepts the cells that its run ends with as those of a next one."""
    from multicell.errors import DataError, SceneError
    from multicell.scene.start_checks import check_start_table
    from multicell.scene.start_table import with_cells

    last = result.frames[-1].cells
    if not len(last):
        return
    # motions name cells that may have gone
    free = result.scene.with_changes({"motions": {}, "initial": {}})
    try:
        check_start_table(with_cells(free, last))
    except (DataError, SceneError) as error:
        raise Fault(f"next start: {error}") from error


def _check_frame(frame):
    for name in type(frame.cells).schema():
        _finite(f"cells.{name}", getattr(frame.cells, name), name)
    if not (frame.cells.radius > 0.0).all():
        raise Fault("radius: not above zero")
    for name, values in frame.concentrations.items():
        _finite(f"concentrations.{name}", values, name)
        if not (values >= 0.0).all():
            raise Fault(f"concentration: {values.min():.3g} at a cell")
    for name, one in frame.fields.items():
        _finite(f"fields.{name}", one.values, name)


def _finite(where, values, name):
    values = np.asarray(values)
    good = np.isfinite(values) if values.dtype.kind == "f" else np.ones(values.shape, bool)
    if name in ENDLESS:
        good |= np.isposinf(values)
    if any(fnmatch.fnmatchcase(name, known) for known in ABSENT_WORDS):
        good |= np.isnan(values)
    if not good.all():
        raise Fault(f"not finite: {where} has {values[~good].ravel()[0]}")


def _walk(where, value):
    if isinstance(value, dict):
        for name, entry in value.items():
            _walk(f"{where}.{name}", entry)
    elif isinstance(value, float):
        _finite(where, value, where.rsplit(".", 1)[1])


def _check_numbers(result, summary):
    """Check that cells come from divisions and go by removal only, and volume by growth, death."""
    scene, last = result.scene, result.frames[-1].cells
    # each cell stands for several where the scene says so, rounded to whole ones
    each = scene.cells.represents or 1.0
    divisions, removals = (round(summary[name] / each) for name in ("divisions", "removals"))
    expected = scene.initial.count + divisions - removals
    counted = round(len(last) * each)
    if not counted == summary["cells"] == result.history["cells"][-1] == round(expected * each):
        raise Fault(f"cells: {len(last)} in the frame, {summary['cells']} counted, {expected} due")
    born = result.lineage["id"]
    if len(born) != scene.initial.count + 2 * divisions or len(set(born)) != len(born):
        raise Fault(f"lineage: {len(born)} cells after {divisions} divisions")
    if not set(last.id) <= set(born):
        raise Fault("lineage: a cell was never born")
    before, after = result.frames[0].cells.volume.sum(), last.volume.sum()
    if scene.growth is None and scene.death is None and not np.isclose(before, after, rtol=1e-9):
        raise Fault(f"volume: from {before:.6g} to {after:.6g} without growth and death")
    if scene.death is None and after < before * (1.0 - 1e-9):
        raise Fault(f"volume: from {before:.6g} down to {after:.6g} without death")


# --- many cases --------------------------------------------------------------------------------


@dataclass
class Tally:
    counts: collections.Counter = field(default_factory=collections.Counter)
    faults: dict = field(default_factory=dict)

    @property
    def total(self):
        return sum(self.counts.values())

    def add(self, verdict, entries):
        """Count a verdict; of each kind of fault the smallest scene is kept."""
        if verdict.startswith("FAULT "):
            kind = verdict.splitlines()[0]
            if kind not in self.faults or len(repr(entries)) < len(repr(self.faults[kind][1])):
                self.faults[kind] = (verdict, entries)
            verdict = "FAULT"
        self.counts[verdict] += 1

    def __str__(self):
        """Return one line of counts, and every kind of fault with a scene that shows it."""
        counts = ", ".join(f"{name} {count}" for name, count in self.counts.most_common())
        lines = [f"{self.total}: {counts}"]
        for verdict, entries in self.faults.values():
            lines += ["", verdict, f"scene: {entries!r}"]
        return "\n".join(lines)


def judged(kind, entries):
    """Return the outcome of a case, or a text that begins with ``FAULT``."""
    try:
        return (load_case if kind == "load" else run_case)(entries)
    except Fault as fault:
        return f"FAULT {fault}"
    except Exception as error:
        places = traceback.extract_tb(error.__traceback__)
        place = next((p for p in reversed(places) if "multicell/" in p.filename), places[-1])
        where = f"{Path(place.filename).name}:{place.name}"
        return f"FAULT raw {type(error).__name__} in {where}: {str(error)[:100]}\n" + "".join(
            traceback.format_tb(error.__traceback__)[-6:]
        )


def draw(kind, seed, number, noted):
    """Draw and judge cases; note each one, and then its verdict, in a file."""
    import hypothesis
    import scene_strategies
    from hypothesis import HealthCheck, Phase, given, settings

    from multicell.scene.scene import load_scene

    explained(load_scene("spheroid"))  # what is imported once is no case's
    with open(noted, "wb", buffering=0) as file:
        if kind == "compose":
            from composed_scenes import composed

            for case in range(number):
                entries = composed(np.random.default_rng([seed, case]))
                pickle.dump(entries, file)
                pickle.dump(judged(kind, entries), file)
            return

        @hypothesis.seed(seed)
        @settings(
            max_examples=number, database=None, deadline=None, phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        @given(entries=scene_strategies.wild() if kind == "load" else scene_strategies.plausible())
        def each(entries):
            pickle.dump(entries, file)
            pickle.dump(judged(kind, entries), file)

        each()


BATCH = {"load": 100, "run": 8, "compose": 8}
"""Cases of one seed and process: hypothesis makes new cases of old ones."""


def campaign(kind, number, forks, place, first_seed=0):
    """Draw and judge ``number`` cases in processes that are killed where one hangs."""
    tally = Tally()
    limit = 60.0 + BATCH[kind] * (SECONDS_TO_LOAD if kind == "load" else SECONDS_TO_RUN)
    for batch, begin in enumerate(range(0, number, BATCH[kind])):
        noted = place / f"{kind}-{batch}"
        task = {"kind": kind, "seed": first_seed + batch, "noted": str(noted),
                "number": min(BATCH[kind], number - begin)}  # fmt: skip
        done = forks.ask(function="scene_harness:draw", limit=limit, **{"with": task})
        found = []
        with noted.open("rb") as file, contextlib.suppress(EOFError):
            while True:
                found.append(pickle.load(file))
        if len(found) % 2:  # hung or died
            found.append(f"FAULT ended by {done['code']}: {done['text'][-1000:]}")
        elif done["code"] != 0:
            raise RuntimeError(f"a process ended between two cases: {done}")
        for entries, verdict in zip(found[::2], found[1::2], strict=True):
            tally.add(verdict, entries)
    return tally
