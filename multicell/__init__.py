"""Centre-based simulation of multicellular tissue.

>>> import multicell as mc
>>> scene = mc.load_scene("spheroid").with_changes({"duration": "2 d"})
>>> result = mc.run(scene)                                      # doctest: +SKIP
"""

import os
import sys

# "python -m multicell" looks for modules in the working folder first, also for Python's own ones
# that are not loaded yet; where multicell itself is there it stays
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    _here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if os.path.abspath(sys.path[0]) != _here:
        del sys.path[0]

from importlib import import_module
from typing import TYPE_CHECKING, Any

from multicell.errors import MulticellError, OutputError, SceneError, StepFailed
from multicell.host.surroundings import ignore_settings_of_working_folder

ignore_settings_of_working_folder()

if TYPE_CHECKING:
    from multicell import testing
    from multicell.behaviours.custom import response
    from multicell.behaviours.growth_laws.custom import growth_law
    from multicell.calibration.dose_response import dose_response
    from multicell.calibration.dose_response_result import DoseResponse
    from multicell.calibration.fit import fit
    from multicell.calibration.fitted import Fit
    from multicell.calibration.predictive import compare_fits
    from multicell.calibration.sensitivity import sensitivity
    from multicell.calibration.sensitivity_result import Sensitivity
    from multicell.calibration.stored import load_fit
    from multicell.cells import Cells, State
    from multicell.comparison.result import WorkPrecision
    from multicell.comparison.stability_limits.result import StabilityMap
    from multicell.comparison.stability_limits.search import stability
    from multicell.comparison.work_precision import compare
    from multicell.contact.custom import load_law, pair_law
    from multicell.contact.hertz import Hertz
    from multicell.contact.jkr import JKR
    from multicell.importing.imported import Imported
    from multicell.importing.physicell.reader import import_physicell
    from multicell.integrators.base import Integrator, MethodInfo, Outcome
    from multicell.mechanics.motion import StateRejected
    from multicell.nutrient.equations.equation import FieldEquation
    from multicell.nutrient.equations.implicit_solver import ImplicitFieldSolver
    from multicell.nutrient.equations.schedule import Schedule
    from multicell.nutrient.equations.steady_solver import SteadyFieldSolver
    from multicell.nutrient.equations.substance import Substance
    from multicell.nutrient.problem import FieldProblem, field_problem
    from multicell.nutrient.reactions.own import OwnReaction, reaction
    from multicell.ode import OdeProblem, ode_problem
    from multicell.report.exports.files import export
    from multicell.report.result import Result, load_result
    from multicell.results.observable import Observable
    from multicell.results.own_observable import load_observable, observable
    from multicell.runner import resume, run
    from multicell.scene.coarsening import coarsen
    from multicell.scene.reactions import Reaction
    from multicell.scene.scene import Scene, load_scene, scene_names
    from multicell.simulation import Simulation
    from multicell.studies.derivatives import gradient
    from multicell.studies.run_table import RunTable, compare_coarse
    from multicell.studies.study import Study, load_study, study

__version__ = "0.1.0"

__all__ = [
    "JKR",
    "Cells",
    "DoseResponse",
    "FieldEquation",
    "FieldProblem",
    "Fit",
    "Hertz",
    "ImplicitFieldSolver",
    "Imported",
    "Integrator",
    "MethodInfo",
    "MulticellError",
    "Observable",
    "OdeProblem",
    "Outcome",
    "OutputError",
    "OwnReaction",
    "Reaction",
    "Result",
    "RunTable",
    "Scene",
    "SceneError",
    "Schedule",
    "Sensitivity",
    "Simulation",
    "StabilityMap",
    "State",
    "StateRejected",
    "SteadyFieldSolver",
    "StepFailed",
    "Study",
    "Substance",
    "WorkPrecision",
    "coarsen",
    "compare",
    "compare_coarse",
    "compare_fits",
    "dose_response",
    "export",
    "field_problem",
    "fit",
    "gradient",
    "growth_law",
    "import_physicell",
    "load_fit",
    "load_law",
    "load_observable",
    "load_result",
    "load_scene",
    "load_study",
    "observable",
    "ode_problem",
    "pair_law",
    "reaction",
    "response",
    "resume",
    "run",
    "scene_names",
    "sensitivity",
    "stability",
    "study",
    "testing",
]

_LAZY = {
    "load_law": "multicell.contact.custom",
    "pair_law": "multicell.contact.custom",
    "growth_law": "multicell.behaviours.growth_laws.custom",
    "response": "multicell.behaviours.custom",
    "Cells": "multicell.cells",
    "Hertz": "multicell.contact.hertz",
    "FieldEquation": "multicell.nutrient.equations.equation",
    "FieldProblem": "multicell.nutrient.problem",
    "field_problem": "multicell.nutrient.problem",
    "ImplicitFieldSolver": "multicell.nutrient.equations.implicit_solver",
    "OwnReaction": "multicell.nutrient.reactions.own",
    "Reaction": "multicell.scene.reactions",
    "reaction": "multicell.nutrient.reactions.own",
    "Schedule": "multicell.nutrient.equations.schedule",
    "SteadyFieldSolver": "multicell.nutrient.equations.steady_solver",
    "Substance": "multicell.nutrient.equations.substance",
    "Imported": "multicell.importing.imported",
    "import_physicell": "multicell.importing.physicell.reader",
    "Integrator": "multicell.integrators.base",
    "MethodInfo": "multicell.integrators.base",
    "OdeProblem": "multicell.ode",
    "Outcome": "multicell.integrators.base",
    "ode_problem": "multicell.ode",
    "JKR": "multicell.contact.jkr",
    "Result": "multicell.report.result",
    "Scene": "multicell.scene.scene",
    "Simulation": "multicell.simulation",
    "State": "multicell.cells",
    "StateRejected": "multicell.mechanics.motion",
    "load_result": "multicell.report.result",
    "Observable": "multicell.results.observable",
    "load_observable": "multicell.results.own_observable",
    "observable": "multicell.results.own_observable",
    "load_scene": "multicell.scene.scene",
    "coarsen": "multicell.scene.coarsening",
    "WorkPrecision": "multicell.comparison.result",
    "StabilityMap": "multicell.comparison.stability_limits.result",
    "compare": "multicell.comparison.work_precision",
    "export": "multicell.report.exports.files",
    "resume": "multicell.runner",
    "run": "multicell.runner",
    "scene_names": "multicell.scene.scene",
    "stability": "multicell.comparison.stability_limits.search",
    "DoseResponse": "multicell.calibration.dose_response_result",
    "dose_response": "multicell.calibration.dose_response",
    "Sensitivity": "multicell.calibration.sensitivity_result",
    "sensitivity": "multicell.calibration.sensitivity",
    "Fit": "multicell.calibration.fitted",
    "fit": "multicell.calibration.fit",
    "load_fit": "multicell.calibration.stored",
    "compare_fits": "multicell.calibration.predictive",
    "Study": "multicell.studies.study",
    "load_study": "multicell.studies.study",
    "study": "multicell.studies.study",
    "compare_coarse": "multicell.studies.run_table",
    "gradient": "multicell.studies.derivatives",
    "RunTable": "multicell.studies.run_table",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: numba and SUNDIALS take their time."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    if name == "testing":
        return import_module("multicell.testing")
    raise AttributeError(f"module 'multicell' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
