"""Cost of `auto` over the best method, in coupling steps of real runs of all built-in scenes.

Problem   coupling steps of each built-in scene that moves cells, of scenes known to be hard to
          choose for, and (--invented) of scenes that no choice was tuned on. A run by the scene's
          defaults is recorded for some seconds of CPU; the first, middle and last step and those
          with the most divisions and the fastest motion of it are solved
Error     as in the tiles of docs/which-integrator.md: root mean square distance of the cells from
          the reference, over that of the motion that the best dilation leaves
Question  CPU time of `auto` over that of the best method, at errors of 1 % and 0.1 %, each at the
          tolerance of one ladder that is cheapest (tile_race.py); what null methods leave
Floor     the same ratio for a choice that knows which method was best in the step beside: each
          step is solved with the one that follows it. No rule that judges a step by its state can
          be expected to be nearer to the best method, which is found by trying
Cost      printed; 50 minutes of CPU in one thread
Command   python tests/benchmarks/auto_regret.py --results FOLDER [--scenes NAME ...] [--invented]

What is in FOLDER is not solved again; ``--again`` solves `auto` and what was near the best
again, after a change of `auto`.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "programs"))

from tile_problems import Solved, Tile, reference
from tile_race import REACHED, race
from tiles import cpu_time, keep, kept, registered

import multicell as mc
from multicell.comparison.ladders import capable_methods, find_method
from multicell.comparison.null_methods import NULL_METHODS, MotionScale
from multicell.comparison.record import StepRecorder
from multicell.comparison.replay import ReplayProblem, Step
from multicell.errors import SceneError
from multicell.integrators.registry import from_options
from multicell.mechanics.decay_rate import largest_decay_rate

GOALS = (0.01, 0.001)
SECONDS, MOST_STEPS = 3.0, 200
"""CPU time and coupling steps for which a scene is run."""
BAD, NEAR = 1.3, 1.2
BESIDE = ", next"

Row = dict[str, Any]
KNOWN: dict[str, tuple[str, dict[str, Any]]] = {
    "10,000 stiff, no divisions": ("grow-2000", {
        "initial.count": 10_000, "initial.stage": "birth", "drag.viscosity": 0.02,
        "stop_cells": None, "initial.jitter": 0.05, "duration": "1 h"}),
    "1,000 stiff, no divisions": ("grow-2000", {
        "initial.count": 1_000, "initial.stage": "birth", "drag.viscosity": 0.02,
        "stop_cells": None, "initial.jitter": 0.05, "duration": "3 h"}),
    "chain, strong adhesion": ("settle", {
        "initial.count": 40, "initial.shape": "row", "contact.surface_energy": 0.3,
        "coupling_step": "10 min", "duration": "3 h"}),
    "stretch": ("compression", {
        "initial.count": 30, "motions.plate.velocity": [0.0, 0.0, 0.01],
        "motions.base.z": ["-40 um", "-6 um"], "motions.plate.z": ["6 um", "40 um"],
        "motions.rest.z": ["6 um", "40 um"]}),
    "growing at 0.5": ("grow-2000", {"drag.viscosity": 0.5, "duration": "12 h"}),
    "growing at 0.05": ("grow-2000", {"drag.viscosity": 0.05, "duration": "8 h"}),
    "growing at 0.01": ("growth", {
        "drag.viscosity": 0.01, "initial.count": 50, "initial.stage": "uniform",
        "initial.jitter": 0.02, "duration": "24 h"}),
}  # fmt: skip
"""Name -> scene that it starts from, and what is changed of it."""
INVENTED: dict[str, tuple[str, dict[str, Any]]] = {
    "five springs in water": ("settle", {
        "initial.count": 5, "contact": {"law": "cubic"}, "drag.viscosity": 0.02}),
    "exact JKR in syrup": ("grow-2000", {
        "initial.count": 120, "contact": {"law": "exact-jkr", "surface_energy": 0.1},
        "drag.viscosity": 50.0, "duration": "1 d"}),
    "plane at 0.1": ("grow-2000", {
        "initial.count": 150, "dimensions": 2, "initial.jitter": 0.0, "drag.viscosity": 0.1,
        "duration": "12 h"}),
    "friction at 0.2": ("grow-2000", {
        "initial.count": 80, "friction": {"normal": 0.1, "tangential": 0.05},
        "drag.viscosity": 0.2, "duration": "6 h"}),
    "box at 0.5": ("growth", {
        "initial.count": 100, "initial.stage": "uniform", "drag.viscosity": 0.5,
        "domain": {axis: ["-25 um", "25 um"] for axis in "xyz"}, "duration": "8 h"}),
    "pulled pair at 0.05": ("doublet", {
        "drag.viscosity": 0.05, "coupling_step": "2 min", "duration": "1 h"}),
    "driven, Hertz": ("compression", {
        "initial.count": 400, "contact": {"law": "hertz"}, "drag.viscosity": 1.0}),
    "motile at 0.05": ("settle", {
        "initial.count": 300, "motility": {"force": "0.3 nN", "persistence": "10 min"},
        "drag.viscosity": 0.05, "coupling_step": "5 min"}),
    "sorting at 5": ("sorting", {"drag.viscosity": 5.0, "initial.count": 250}),
    "5,000 growing at 0.3": ("grow-2000", {
        "initial.count": 5_000, "stop_cells": None, "drag.viscosity": 0.3, "duration": "1 h"}),
}  # fmt: skip


def scene_of(name: str) -> mc.Scene:
    base, changes = (KNOWN | INVENTED).get(name, (name, {}))
    return mc.load_scene(base).with_changes(changes)


def recorded(name: str, count: int = 0) -> list[tuple[str, ReplayProblem]]:
    """Return coupling steps of a run with what they are.

    The run has ``count`` coupling steps, or without it those that some seconds of CPU time allow.
    """
    scene = scene_of(name)
    recorder = StepRecorder(from_options(scene.integrator), samples=10**6)
    simulation = mc.Simulation(scene, threads=1, integrator=recorder)
    divided, begin = [], time.process_time()
    while (
        not simulation.finished and len(simulation.cells) and recorder.total < (count or MOST_STEPS)
    ):
        known, total = simulation.next_id, recorder.total
        simulation.step()
        if recorder.total > total:
            # daughters move in the step after
            divided += [simulation.next_id - known] * (recorder.total - total)
        if not count and time.process_time() - begin > SECONDS and recorder.total > 1:
            break
    steps = recorder.select()
    if not steps:
        return []
    moved = [np.linalg.norm(s.end - s.start, axis=1).max() for s in steps]
    born = np.divide([0, *divided[:-1]], [len(s.end) for s in steps])
    last = len(steps) - 1
    picked = {0: "first", last // 2: "middle", last: "last", int(np.argmax(moved)): "fastest"}
    if born.max() > 0:
        picked[int(born.argmax())] = "divided"
    for k, words in sorted(picked.items()):
        picked.setdefault(min(k + 1, last), f"{words}{BESIDE}")
    return [
        (f"{words} ({k + 1} of {last + 1})", _alone(scene, recorder.system, steps[k]))
        for k, words in sorted(picked.items())
    ]


def _alone(scene: mc.Scene, template: Any, step: Any) -> ReplayProblem:
    return ReplayProblem(
        scene, template, step.start, step.motion.radius, [Step(step.motion)], [step.start], 1
    )


def solved(name: str, problem: ReplayProblem) -> Solved:
    system, motion = problem.system(), problem.steps[0].motion
    system.begin(motion)
    dimensions = problem.scene.dimensions
    rate = largest_decay_rate(system, motion.begin, problem.start, dimensions=dimensions)
    stiffness = max(float(np.nan_to_num(rate)), 0.0) * (motion.end - motion.begin)
    held = reference(problem, stiffness, GOALS)
    scale = MotionScale.of(problem.start, held["end"], problem.mean_radius)
    facts = {"lambda_dt": stiffness, "reference_s": float(held["cost"])}
    return Solved(
        Tile(name, len(problem.start), stiffness, 0), problem, held["end"], scale,
        scale.errors(held["check"], held["end"])[0], (), facts, GOALS,
    )  # fmt: skip


def measured(name: str, again: list[Row] | None) -> list[Row]:
    """Return rows of all steps of a scene, a row for each method and goal.

    With ``again``, rows of earlier, `auto` and what was near the best alone are solved.
    """
    rows: list[Row] = []
    count = max((int(r["of"]) for r in again or () if r["scene"] == name), default=0)
    for turn, (words, problem) in enumerate(recorded(name, count)):
        begin, step = cpu_time(), solved(name, problem)
        names = [n for n in registered() if n in capable_methods(problem.scene)]
        if again is not None:
            here = [r for r in again if (r["scene"], r["step"]) == (name, words)]
            near = {
                r["method"] for goal in GOALS for r in here
                if (best := _best(here, goal)) and r["goal"] == goal
                and r["status"] == REACHED and r["cost"] <= NEAR * best["cost"]
            }  # fmt: skip
            names = [n for n in names if n == "auto" or n in near or not here]
        methods = [find_method(n, problem.scene, problem.mean_radius) for n in names]
        nulls = [find_method(n, problem.scene, problem.mean_radius) for n in NULL_METHODS]
        about = {
            "scene": name, "step": words, "of": int(words.split()[-1][:-1]),
            "cells": len(problem.start), "lambda_dt": step.facts["lambda_dt"],
            "uncertainty": step.uncertainty,
        }  # fmt: skip
        found = [about | row for row in race(step, [*methods, *nulls], turn)]
        took = cpu_time() - begin
        print(f"  {words}, {len(problem.start)} cells: {took:.1f} s of CPU", flush=True)
        rows += [row | {"took_s": took} for row in found]
    return rows


def _best(rows: list[Row], goal: float) -> Row | None:
    """Return the cheapest row of a goal but that of `auto`; None if none reached it."""
    able = [
        r for r in rows
        if r["goal"] == goal and r["status"] == REACHED
        and r["method"] not in NULL_METHODS and r["method"] != "auto"
    ]  # fmt: skip
    return min(able, key=lambda row: row["cost"], default=None)


def regrets(rows: list[Row]) -> list[Row]:
    """Return auto / best of each step and goal that can be compared."""
    steps: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        steps.setdefault((row["scene"], row["step"]), []).append(row)
    found = []
    for (scene, words), here in steps.items():
        null = min(r["error"] for r in here if r["method"] in NULL_METHODS)
        for goal in GOALS:
            best = _best(here, goal)
            auto = [r for r in here if r["goal"] == goal and r["method"] == "auto"]
            if best is None or not auto:
                continue
            own = auto[0]["cost"] if auto[0]["status"] == REACHED else math.inf
            found.append({
                "scene": scene, "step": words, "goal": goal, "cells": int(here[0]["cells"]),
                "lambda_dt": here[0]["lambda_dt"], "null": null, "best": best["method"],
                "setting": best["setting"], "cost_ms": 1e3 * best["cost"],
                "auto_setting": auto[0]["setting"], "ratio": own / best["cost"],
                "sure": here[0]["uncertainty"] <= 0.5 * goal and null > goal,
            })  # fmt: skip
    return found


def floor(rows: list[Row], sure: list[Row]) -> list[float]:
    """Return the cost of a step's best method in the step beside, over the best one's there."""
    place = {r["step"]: int(r["step"].split("(")[1].split()[0]) for r in sure}
    found = []
    for here in sure:
        for other in sure:
            same = (here["scene"], here["goal"]) == (other["scene"], other["goal"])
            if same and abs(place[here["step"]] - place[other["step"]]) == 1:
                cost = [
                    r["cost"] if r["status"] == REACHED else math.inf for r in rows
                    if all(r[n] == here[n] for n in ("scene", "step", "goal"))
                    and r["method"] == other["best"]
                ]  # fmt: skip
                found += [1e3 * c / here["cost_ms"] for c in cost]
    return found


def table(rows: list[Row]) -> str:
    """Return a line for each scene, and one for each step that `auto` chooses badly in."""
    found = regrets(rows)
    lines = ["| scene | cells | λΔt | null methods leave | auto / best at 1 %: median, worst "
             "| at 0.1 % | steps |", "|---|---|---|---|---|---|---|"]  # fmt: skip
    for scene in dict.fromkeys(r["scene"] for r in found):
        here = [r for r in found if r["scene"] == scene]
        cells, stiff, null = (_span([r[n] for r in here]) for n in ("cells", "lambda_dt", "null"))
        words = []
        for goal in GOALS:
            ratios = [r["ratio"] for r in here if r["goal"] == goal and r["sure"]]
            words.append(f"{median(ratios):.2f}, {max(ratios):.2f}" if ratios else "–")
        steps = len({r["step"] for r in here})
        lines.append(f"| `{scene}` | {cells} | {stiff} | {null} | {' | '.join(words)} | {steps} |")
    bad = [r for r in found if r["sure"] and r["ratio"] > BAD]
    for r in sorted(bad, key=lambda r: -r["ratio"]):
        lines.append(
            f"{r['ratio']:.2f}: {r['scene']}, {r['step']}, {r['cells']} cells, λΔt "
            f"{r['lambda_dt']:.3g}, {100 * r['goal']:g} %: {r['best']} at {r['setting']:.2g} µm "
            f"{r['cost_ms']:.3g} ms, auto at {r['auto_setting']:.2g} µm"
        )
    sure = [r for r in found if r["sure"]]
    unsure = len(found) - len(sure)
    lines.append(f"auto: {_summary([r['ratio'] for r in sure])}")
    lines.append(f"the best method of the step beside: {_summary(floor(rows, sure))}")
    lines.append(f"{unsure} left out: a null method is as near, or references differ by half of it")
    return "\n".join(lines)


def _summary(ratios: list[float]) -> str:
    if not ratios:
        return "no ratios"
    return (
        f"{len(ratios)} ratios, median {median(ratios):.2f}, 90 % below "
        f"{np.quantile(ratios, 0.9):.2f}, worst {max(ratios):.2f}, "
        f"{sum(r > BAD for r in ratios)} above {BAD}"
    )


def _span(values: list[float]) -> str:
    low, high = (f"{x:.2g}" if x < 100 else f"{x:.3g}" for x in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("auto-regret"))
    parser.add_argument("--scenes", nargs="+", default=[*mc.scene_names(), *KNOWN])
    parser.add_argument("--invented", action="store_true")
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--budget-minutes", type=float, default=25.0)
    given = parser.parse_args()
    if given.invented:
        given.scenes = list(INVENTED)
    folder = given.results
    first = kept(folder, "auto-regret")
    name = "auto-regret-again" if given.again else "auto-regret"
    rows, begin = kept(folder, name), cpu_time()
    done = {row["scene"] for row in rows}
    for scene in given.scenes:
        if scene in done or cpu_time() - begin > 60.0 * given.budget_minutes:
            continue
        start = cpu_time()
        try:
            found = measured(scene, first if given.again else None)
        except SceneError as error:
            print(f"{scene}: {error}")
            continue
        print(f"{scene}: {cpu_time() - start:.0f} s of CPU", flush=True)
        if found:
            keep(folder, name, found)
            rows += found
    print(f"{(cpu_time() - begin) / 60.0:.1f} min of CPU\n\n{table(rows)}")


if __name__ == "__main__":
    main()
