"""What drives single cells, for :mod:`multicell.report.explain.contact`."""

from __future__ import annotations

import math

from multicell.report.explain.items import Part, hours, part
from multicell.scene.driven import Driver
from multicell.scene.scene import Scene


def driven_parts(scene: Scene) -> list[Part]:
    """Return forces from outside and prescribed motions, used or absent."""
    forces = [
        f"{name}: {math.hypot(*law.force):.3g} nN on {_whom(law)}{_when(law)}"
        for name, law in scene.forces.items()
    ]
    motions = [
        f"{name}: {_whom(law)} {_motion_words(law.velocity)}{_when(law)}"
        for name, law in scene.motions.items()
    ]
    return [part("forces", "; ".join(forces)), part("motions", "; ".join(motions))]


def drift(bias: float, dimensions: int) -> float:
    """Return the mean part of a cell's speed along its bias, from -1 to 1.

    With c = 1 - |b|, in space (2/3) |b|/c for |b| < c, else 1 - c²/(3 b²): the derivative of the
    mean distance from a sphere of radius c. In the plane by the midpoint rule, which converges
    exponentially unless |b| = c.
    """
    b, c = abs(bias), 1.0 - abs(bias)
    if dimensions == 3:
        share = 2.0 * b / (3.0 * c) if b < c else 1.0 - c * c / (3.0 * b * b)
        return math.copysign(share, bias)
    angles = (2.0 * math.pi * (k + 0.5) / 1000 for k in range(1000))
    parts = (b + c * math.cos(a) for a in angles)
    # |b u + c e|² = b² + c² + 2 b c cos = 2 b (b + c cos) + c² - b²
    total = sum(x / math.sqrt(max(2.0 * b * x + c * c - b * b, 1e-300)) for x in parts)
    return math.copysign(total / 1000, bias)


def _whom(driver: Driver) -> str:
    words = []
    if driver.cells is not None:
        few = ", ".join(map(str, driver.cells[:5])) + (", ..." if len(driver.cells) > 5 else "")
        words.append(f"cell(s) {few}")
    if driver.type:
        words.append(f"type {driver.type}")
    for axis in "xyz":
        span = getattr(driver, axis)
        if span is not None:
            words.append(f"{axis} from {span[0]:g} to {span[1]:g} um")
    return " with ".join(words) or "all cells"


def _when(driver: Driver) -> str:
    if driver.begin == 0.0 and driver.end is None:
        return ""
    end = "the end" if driver.end is None else hours(driver.end)
    return f", from {hours(driver.begin)} to {end}"


def _motion_words(velocity: tuple[float, float, float]) -> str:
    speed = math.hypot(*velocity)
    return f"moved at {speed:.3g} um/s" if speed else "held where they are"
