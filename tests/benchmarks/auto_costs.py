"""Counted work of each method in coupling steps: what `auto` is fitted to, and how near it comes.

Problem   coupling steps of small runs, from bitwise the states of a run by the scene's defaults:
          of scenes that the model of costs is fitted to, and (--unseen) the first six steps of ten
          scenes that were drawn after the last fit
Error     as in the tiles of docs/which-integrator.md: root mean square distance of the cells from
          the reference, over that of the motion that the best dilation leaves
Question  counted work and CPU time of `auto` over the least of any method, at errors of 1 and
          0.1 %, each at the tolerance of one ladder that is cheapest. `auto` passes all steps of a
          scene in turn and learns. Counted work is in evaluations of all cells: passes
          (Work.effort) times what a pass costs by a method (multicell/integrators/costs.toml)
Methods   all in the registry with an error control; without --unseen those that `auto` chooses from
Cost      printed; half an hour of CPU in one thread, --unseen ten minutes
Command   python tests/benchmarks/auto_costs.py --results FOLDER [--unseen] [--scenes NAME ...]
          python tests/benchmarks/auto_costs.py --results FOLDER --fit    writes costs.toml
          python tests/benchmarks/auto_costs.py --results FOLDER --unseen --table    the table
          … --beside FILE    and the class Auto of another multicell/integrators/auto.py

What is in FOLDER is not solved again.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "programs"))

from auto_costs_fit import fit
from auto_costs_scenes import TUNED, UNSEEN
from tile_problems import reference
from tiles import registered

import multicell as mc
from multicell.comparison.ladders import capable_methods, find_method
from multicell.comparison.null_methods import MotionScale
from multicell.comparison.record import StepRecorder
from multicell.comparison.replay import ReplayProblem, Step, advance_system
from multicell.errors import SceneError
from multicell.integrators import auto, costs
from multicell.integrators.driver import needs_python
from multicell.integrators.limits import stiffness_scale
from multicell.integrators.registry import from_options
from multicell.mechanics.decay_rate import largest_decay_rate

GOALS = (0.01, 0.001)
TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(9))  # µm
SAMPLED, WINDOW, CONSECUTIVE = 4, 40, 6
"""Steps of a scene that is fitted to, out of how many, and of an unseen one."""
DEAR, LEAST = (12.0, 4.0), (1.0, 0.2)
"""Cost of a solve over the least that reached the finest goal at which a method is given up, and
s of CPU time that any solve may take: of scenes that are fitted to, and of unseen ones."""
TIMES = 5  # how often the solves of which CPU times are compared are timed
SURE = 0.5  # difference of the references over a goal above which a step does not count

OWN, BESIDE = "auto", "auto, beside"

Row = dict[str, Any]


def beside(path: Path) -> Any:
    """Return the class Auto of a file."""
    spec = importlib.util.spec_from_file_location("auto_beside", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module.Auto


def steps_of(scene: mc.Scene, unseen: bool) -> list[tuple[int, ReplayProblem]]:
    """Return coupling steps of a run, each a problem of its own, with their number."""
    recorder = StepRecorder(from_options(scene.integrator), samples=10**6)
    simulation = mc.Simulation(scene, threads=1, integrator=recorder)
    most = CONSECUTIVE if unseen else WINDOW
    while not simulation.finished and len(simulation.cells) and recorder.total < most:
        simulation.step()
    steps = recorder.select()
    chosen = range(len(steps))
    if not unseen and len(steps) > SAMPLED:
        chosen = sorted({*range(SAMPLED - 1), len(steps) - 1})
    return [
        (
            k,
            ReplayProblem(
                scene,
                recorder.system,
                steps[k].start,
                steps[k].motion.radius,
                [Step(steps[k].motion)],
                [steps[k].start],
                1,
            ),
        )
        for k in chosen
    ]


def state_of(problem: ReplayProblem) -> Row:
    """Return properties of a step from which its cost may follow, as `auto` finds them."""
    system, position = problem.system(), problem.start
    system.begin(problem.steps[0].motion)
    motion = system.motion
    length = motion.end - motion.begin
    speed, fastest = auto._speeds(system, position)
    exact = largest_decay_rate(system, motion.begin, position, dimensions=problem.scene.dimensions)
    return {
        "cells": len(position),
        "lambda_dt": max(float(np.nan_to_num(exact)), 0.0) * length,
        "stiffness": auto.measured_rate(system, position) * length,
        "scale": stiffness_scale(system) * length,
        "motion": speed * length,
        "fastest": fastest * length,
        "python": needs_python(system),
        "friction": max(system.friction) > 0.0,
    }


def solve(system: Any, method: Any, start: Any) -> tuple[Row, Any]:
    """Return cost and end of one solve on a system that is made ready for the step."""
    before, begin = system.work.effort, time.process_time()
    words, end = advance_system(system, method, start)
    cpu = time.process_time() - begin
    return {"passes": system.work.effort - before, "cpu": cpu, "failed": bool(words)}, end


def taken_by(system: Any, name: str) -> str:
    """Return the method that took most steps."""
    counts = {n: vars(system.work).get(counter, 0) for n, counter in auto.COUNTERS.items()}
    return max(counts, key=counts.__getitem__) if name in (OWN, BESIDE) else name


def unit(name: str, about: Row) -> float:
    """Return the cost of a pass; of a method that `auto` does not choose from as of `rkc2`."""
    like = {"cvode-adams": "cvode"}.get(name, "rkc2")
    step = costs.CouplingStep(1.0, 1.0, 1.0, about["cells"], about["python"])
    return step.unit(name if name in auto.CANDIDATES else like)


def raced(name: str, scene: mc.Scene, unseen: bool, other: Any = None) -> list[Row]:
    """Return a row of each step of a scene, with all solves."""
    rows, taught = [], {}
    for k, problem in steps_of(scene, unseen):
        about, motion = state_of(problem), problem.steps[0].motion
        held = reference(problem, about["lambda_dt"], GOALS)
        scale = MotionScale.of(problem.start, held["end"], problem.mean_radius)
        names = [n for n in registered() if n in capable_methods(problem.scene)]
        if not unseen:
            names = [n for n in names if n in (*auto.CANDIDATES, OWN)]
        if other is not None:
            names.append(BESIDE)
        solves: list[Row] = []
        again: dict[int, Any] = {}
        over, least = set(), math.inf
        for atol in TOLERANCES:
            for method in names:
                if method in over:
                    continue
                known_as = OWN if method == BESIDE else method
                made = find_method(known_as, problem.scene, problem.mean_radius).make(
                    atol / problem.mean_radius
                )
                made = other(**vars(made)) if method == BESIDE else made
                system = problem.system()
                system.learnt = known = taught.get((method, atol), ())
                system.begin(motion)
                row, end = solve(system, made, problem.start)
                if method in (OWN, BESIDE):
                    taught[method, atol] = system.learnt
                errors = scale.errors(end, held["end"]) if not row["failed"] else (math.inf,) * 2
                taken = taken_by(system, method)
                row |= {
                    "method": method,
                    "atol": atol,
                    "error": errors[0],
                    "worst": errors[1],
                    "taken": taken,
                    "counted": row["passes"] * unit(taken, about),
                }
                again[len(solves)] = (made, known)
                solves.append(row)
                if errors[0] <= GOALS[-1]:
                    least = min(least, row["cpu"])
                # `auto` learns at every tolerance
                most = max(LEAST[unseen], DEAR[unseen] * least)
                if method not in (OWN, BESIDE) and (
                    errors[0] <= 0.3 * GOALS[-1] or row["cpu"] > most
                ):
                    over.add(method)
        _time_again(problem, solves, again)
        rows.append(
            {
                "scene": name,
                "step": k,
                **about,
                "solves": solves,
                "motion_um": scale.rms,
                "uncertainty": scale.errors(held["check"], held["end"])[0],
            }
        )
    return rows


def _time_again(problem: ReplayProblem, solves: list[Row], again: dict[int, Any]) -> None:
    """Time in turns what is compared, and keep the shortest times."""
    chosen: set[int] = set()
    for goal in GOALS:
        able = [k for k, row in enumerate(solves) if row["error"] <= goal]
        for own in (OWN, BESIDE, ""):
            side = [
                k
                for k in able
                if (solves[k]["method"] if solves[k]["method"] in (OWN, BESIDE) else "") == own
            ]
            chosen |= set(sorted(side, key=lambda k: solves[k]["cpu"])[: 1 if own else 3])
            chosen |= set(sorted(side, key=lambda k: solves[k]["counted"])[:1])
    for _ in range(TIMES):
        for k in chosen:
            if solves[k]["cpu"] < 0.1:
                made, known = again[k]
                system = problem.system()
                system.learnt = known
                system.begin(problem.steps[0].motion)
                row, _ = solve(system, made, problem.start)
                solves[k]["cpu"] = min(solves[k]["cpu"], row["cpu"])


def ratios(rows: list[Row], goal: float, cost: str, name: str = OWN) -> list[float]:
    """Return `auto` / best of each step in which that can be said."""
    found = []
    for row in rows:
        able = [s for s in row["solves"] if s["error"] <= goal]
        best = min((s[cost] for s in able if s["method"] not in (OWN, BESIDE)), default=0.0)
        if best > 0.0 and row["uncertainty"] <= SURE * goal:
            own = min((s[cost] for s in able if s["method"] == name), default=math.inf)
            found.append(own / best)
    return found


def table(rows: list[Row]) -> str:
    """Return a line for each scene, and one for all."""
    lines = [
        "| scene | cells | λΔt | counted work at 1 %: median, worst | at 0.1 % "
        "| CPU at 1 %: median, worst | at 0.1 % | `auto` took |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for scene in dict.fromkeys(row["scene"] for row in rows):
        here = [row for row in rows if row["scene"] == scene]
        took: dict[str, int] = {}
        for row in here:
            # at the default tolerance of `auto`
            for s in row["solves"]:
                if s["method"] == OWN and math.isclose(s["atol"], 0.1):
                    took[s["taken"]] = took.get(s["taken"], 0) + 1
        words = [
            f"{median(r):.2f}, {max(r):.2f}" if (r := ratios(here, goal, cost)) else "–"
            for cost in ("counted", "cpu")
            for goal in GOALS
        ]
        names = ", ".join(f"`{name}` {count}" for name, count in took.items())
        lines.append(
            f"| {scene} | {_span(here, 'cells')} | {_span(here, 'lambda_dt')} "
            f"| {' | '.join(words)} | {names} |"
        )
    for name in (OWN, BESIDE):
        lines += [_summary(rows, name, cost) for cost in ("counted", "cpu")]
    return "\n".join(filter(None, lines))


def _summary(rows: list[Row], name: str, cost: str) -> str:
    rows = [row for row in rows if any(s["method"] == name for s in row["solves"])]
    every = [x for goal in GOALS for x in ratios(rows, goal, cost, name)]
    if not every:
        return ""
    within = [100 * np.mean(np.array(every) <= most) for most in (1.3, 2.0)]
    return (
        f"{name}, {cost}: {len(every)} ratios, median {median(every):.2f}, 90 % below "
        f"{np.quantile(every, 0.9, method='higher'):.2f}, worst {max(every):.2f}, within 1.3: "
        f"{within[0]:.0f} %, within 2: {within[1]:.0f} %"
    )


def _span(rows: list[Row], name: str) -> str:
    low, high = (
        f"{x:.2g}" if x < 100 else f"{x:.3g}"
        for x in (min(row[name] for row in rows), max(row[name] for row in rows))
    )
    return low if low == high else f"{low} to {high}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True)
    parser.add_argument("--unseen", action="store_true")
    parser.add_argument("--scenes", nargs="+")
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--beside", type=Path)
    given = parser.parse_args()
    path = given.results / ("unseen.jsonl" if given.unseen else "tuned.jsonl")
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if given.fit:
        print(fit(rows))
        return
    given.results.mkdir(parents=True, exist_ok=True)
    scenes = UNSEEN if given.unseen else TUNED
    other = beside(given.beside) if given.beside else None
    begin, done = time.process_time(), {row["scene"] for row in rows}
    for name in () if given.table else given.scenes or scenes:
        if name in done:
            continue
        base, changes = scenes[name]
        start = time.process_time()
        try:
            found = raced(name, mc.load_scene(base).with_changes(changes), given.unseen, other)
        except SceneError as error:
            raise SystemExit(f"{name}: {error}") from error
        with path.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in found)
        rows += found
        print(f"{name}: {time.process_time() - start:.0f} s of CPU", flush=True)
    print(f"{(time.process_time() - begin) / 60.0:.1f} min of CPU\n\n{table(rows)}")


if __name__ == "__main__":
    main()
