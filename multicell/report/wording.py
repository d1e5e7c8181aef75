"""Numbers of a run in words: times, counts, key figures; nothing of what draws is loaded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from multicell.results.measures import OBSERVABLES
from multicell.results.quantities import entry, title_of, unit_of
from multicell.scene.own_units import own_names


class TimeUnit(NamedTuple):
    """A unit of time that suits a run."""

    name: str
    seconds: float

    def text(self, time: float) -> str:
        """Return a time in this unit, for example ``"8.5 d"``."""
        return f"{time / self.seconds:.3g} {self.name}"


def time_unit(longest: float) -> TimeUnit:
    """Return the unit in which times up to ``longest`` s are easy to read."""
    for name, seconds in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if longest >= 3.0 * seconds:
            return TimeUnit(name, seconds)
    return TimeUnit("s", 1.0)


def cell_count(n: float) -> str:
    """Return for example ``"1,204 cells"``."""
    return f"{n:,.0f} cell{'' if n == 1 else 's'}"


def clock(seconds: float) -> str:
    """Return a wall time in words, for example ``"2 min 14 s"``."""
    if seconds < 60.0:
        return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def measures(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the name and the value in words of each key figure that a summary has."""
    if summary.get("time") is not None:
        yield "simulated time", time_unit(summary["time"]).text(summary["time"])
    for observable in OBSERVABLES:
        if observable.shown is None or observable.entry is None:
            continue
        value = entry(summary, observable.entry)
        if value is None or value != value:  # a rim without a core does not exist
            continue
        if value != 0 or observable.shown_if_zero:
            yield observable.title, observable.shown(value)
    for name in own_names():
        if summary.get(name) is not None:
            yield title_of(name), f"{summary[name]:.4g} {written(unit_of(name))}".strip()


def diagnostics(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield name and value in words of a summary's entries on accuracy and cost."""
    if (amiss := entry(summary, "splitting.relative_volume_error")) is not None:
        yield "volume changed by coupling steps", f"about {100.0 * amiss:+.2g} %"
    if (events := entry(summary, "splitting.events_error")) is not None:
        yield "deaths and changes of type by coupling steps", f"up to about {events:.2g} of them"
    if steps := summary.get("coupling_steps"):
        ends = (f"{steps[end] / 60.0:.3g}" for end in ("shortest", "longest"))
        wrong = 100.0 * summary["splitting"]["first_order_error"]
        more = f"; {steps['exceeded']:,} too long" if steps["exceeded"] else ""
        yield "coupling steps", f"{' to '.join(ends)} min, for about {wrong:.2g} % of volume{more}"
    if (effect := entry(summary, "integrator.largest_shift_effect")) is not None:
        yield "effect of a shift of 0.01 µm", f"up to {effect:.2g} µm in a step"
    if (total := entry(summary, "wall.total")) is not None:
        yield "wall time", clock(total)
    if summary.get("peak_memory") is not None:
        yield "peak memory", f"{summary['peak_memory']:,.0f} MB"
    if (balance := entry(summary, "ledger.relative_remainder")) is not None:
        yield "nutrient unaccounted for", f"{balance:.1e}"
    for name, field in (summary.get("fields") or {}).items():
        if "discretisation_error" in field:
            yield f"grid error of {name}", f"{field['discretisation_error']:.1e} mM"


def percent(part: float) -> str:
    """Return for example ``"12.5 %"``; ``"none"`` for NaN."""
    return f"{100.0 * part:.1f} %" if part == part else "none"


def written(unit: str) -> str:
    """Return a unit as pictures and pages write it."""
    return unit.replace("um", "µm").replace("^3", "³").replace("^2", "²")
