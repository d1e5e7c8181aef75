"""Populations of PhysiCell and of its imported settings: cells, volumes, and what is Ki67-positive.

Writes five models, runs PhysiCell on each with two seeds, and the import with three seeds. The
program is that of the template project of PhysiCell, whose C++ code adds nothing to the settings.
Cost: about ten minutes on one core, most of it for the fields of the last model.
Command: python tests/benchmarks/compare_physicell.py PROJECT [--models ki67,flow,volume,disc]
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

import multicell as mc
from multicell.biology.initial import packed_disc

NEGATIVE, DEAD = 3, 100  # codes of PhysiCell: the phase Ki67-, and cycles of the dead from here on


def phases(code, *lengths):
    """Return a cycle of phases, min; exponential where a length is negative."""
    rows = "".join(
        f'<duration index="{place}" fixed_duration="{str(length > 0).lower()}">{abs(length)}'
        "</duration>"
        for place, length in enumerate(lengths)
    )
    return f'<cycle code="{code}" name="cycle"><phase_durations>{rows}</phase_durations></cycle>'


MODELS = {
    # cycle, cells, hours between outputs and how many, rules
    "ki67": (phases(0, -217.2, 780.0, 150.0), 50, 12, 6, ""),
    "flow": (phases(2, -1 / 0.00324, -1 / 0.00208, -1 / 0.00333), 100, 12, 4, ""),
    "volume": (phases(5, -1 / 0.00072), 200, 1, 4,
               "default,volume,increases,cycle entry,0.05,2400,8,0\n"),
    "disc": (phases(6, -500.0, 250.0, 240.0, 60.0), 73, 24, 2, ""),
    # in oxygen, with 20 cells that move and become such ones where they touch them
    "rules": (phases(5, -1 / 0.0002), 121, 12, 4,
              "default,oxygen,increases,cycle entry,0.0015,20,4,0\n"
              "default,pressure,decreases,cycle entry,0,1,4,0\n"
              "default,oxygen,decreases,necrosis,0,4,4,0\n"
              "mover,contact with default,increases,transform to default,0.002,0.5,8,0\n"),
}  # fmt: skip
ALONE = ("10", "1", "0", 'enabled="false"', "0", "0.1")
IN_OXYGEN = ("100000", "0.1", "38", 'enabled="true"', "10", "0.01")
"""Diffusion, decay, value at the start and at the sides, whether these are fixed, uptake; step."""
MOVER = """<cell_definition name="mover" ID="1"><phenotype>
<cycle code="5" name="live"><phase_transition_rates>
<rate start_index="0" end_index="0" fixed_duration="false">0</rate></phase_transition_rates></cycle>
<motility><speed>0.5</speed><persistence_time>10</persistence_time><migration_bias>0</migration_bias>
<options><enabled>true</enabled><use_2D>true</use_2D></options></motility>
</phenotype></cell_definition>"""
SETTINGS = """<PhysiCell_settings version="1.14">
<domain><x_min>-800</x_min><x_max>800</x_max><y_min>-800</y_min><y_max>800</y_max>
<z_min>-10</z_min><z_max>10</z_max><dx>20</dx><dy>20</dy><dz>20</dz><use_2D>true</use_2D></domain>
<overall><max_time>{minutes}</max_time><time_units>min</time_units><space_units>micron</space_units>
<dt_diffusion>{field[5]}</dt_diffusion><dt_mechanics>0.1</dt_mechanics><dt_phenotype>6</dt_phenotype>
</overall>
<parallel><omp_num_threads>1</omp_num_threads></parallel>
<save><folder>{folder}/output</folder>
<full_data><interval>{every}</interval><enable>true</enable></full_data>
<SVG><interval>{every}</interval><enable>false</enable></SVG>
<legacy_data><enable>false</enable></legacy_data></save>
<options><virtual_wall_at_domain_edge>true</virtual_wall_at_domain_edge>
<random_seed>{seed}</random_seed></options>
<microenvironment_setup><variable name="oxygen" units="mmHg" ID="0">
<physical_parameter_set><diffusion_coefficient>{field[0]}</diffusion_coefficient>
<decay_rate>{field[1]}</decay_rate></physical_parameter_set>
<initial_condition>{field[2]}</initial_condition>
<Dirichlet_boundary_condition {field[3]}>{field[2]}</Dirichlet_boundary_condition></variable>
<options><calculate_gradients>false</calculate_gradients></options></microenvironment_setup>
<cell_definitions><cell_definition name="default" ID="0"><phenotype>{cycle}
<death><model code="100" name="apoptosis"><death_rate>0</death_rate></model>
<model code="101" name="necrosis"><death_rate>0</death_rate></model></death>
<volume><total>2494</total><fluid_fraction>0.75</fluid_fraction><nuclear>540</nuclear>
<fluid_change_rate>0.05</fluid_change_rate>
<cytoplasmic_biomass_change_rate>0.0045</cytoplasmic_biomass_change_rate>
<nuclear_biomass_change_rate>0.0055</nuclear_biomass_change_rate></volume>
<mechanics><cell_cell_adhesion_strength>0.4</cell_cell_adhesion_strength>
<cell_cell_repulsion_strength>10</cell_cell_repulsion_strength>
<relative_maximum_adhesion_distance>1.25</relative_maximum_adhesion_distance></mechanics>
<motility><options><enabled>false</enabled></options></motility>
<secretion><substrate name="oxygen"><uptake_rate>{field[4]}</uptake_rate></substrate></secretion>
</phenotype></cell_definition>{mover}</cell_definitions>
<initial_conditions><cell_positions type="csv" enabled="true"><folder>{folder}/config</folder>
<filename>cells.csv</filename></cell_positions></initial_conditions>
<cell_rules><rulesets><ruleset protocol="CBHG" version="3.0" format="csv" enabled="{ruled}">
<folder>{folder}/config</folder><filename>rules.csv</filename></ruleset></rulesets></cell_rules>
<user_parameters><number_of_cells type="int" units="none">0</number_of_cells></user_parameters>
</PhysiCell_settings>
"""


def write(folder, name, seed):
    """Write a model; return the path of its settings."""
    cycle, count, hours, outputs, rules = MODELS[name]
    for part in ("config", "output"):
        (folder / part).mkdir(parents=True)
    rows = (f"{x},{y},0,default\n" for x, y, _ in 16.0 * packed_disc(count))
    angle, around = np.arange(20) * np.pi / 10, name == "rules"
    ring = (f"{x},{y},0,mover\n" for x, y in 120.0 * np.c_[np.cos(angle), np.sin(angle)])
    text = "x,y,z,type\n" + "".join(rows) + "".join(ring if around else ())
    (folder / "config/cells.csv").write_text(text)
    (folder / "config/rules.csv").write_text(rules)
    text = SETTINGS.format(
        folder=folder, seed=seed, cycle=cycle, every=60 * hours, minutes=60 * hours * outputs,
        ruled=str(bool(rules)).lower(), field=IN_OXYGEN if around else ALONE,
        mover=MOVER if around else "",
    )  # fmt: skip
    (folder / "config/settings.xml").write_text(text)
    return folder / "config/settings.xml"


def of_physicell(program, path):
    """Run PhysiCell; return numbers of cells, mean volumes, Ki67+ and distances, by output."""
    with (path.parent / "log").open("w") as log:
        subprocess.run([program, path], check=True, stdout=log, cwd=path.parents[1])
    output = path.parents[1] / "output"
    text = (output / "output00000000.xml").read_text()
    known = re.findall(r'<label index="(\d+)" size="\d+"[^>]*>([^<]*)</label>', text)
    row = {label: int(place) for place, label in known}
    made = []
    for file in sorted(output.glob("output*_cells.mat")):
        cells = loadmat(file)["cells"]
        cells = cells[:, cells[row["cycle_model"]] < DEAD]
        movers = (cells[row["cell_type"]] == 1).sum()
        place = cells[row["position"] : row["position"] + 2]
        made.append((
            cells.shape[1], cells[row["total_volume"]].mean(),
            (cells[row["current_phase"]] != NEGATIVE).mean(),
            np.sqrt((place**2).sum(axis=0).mean()), movers,
        ))  # fmt: skip
    return np.array(made)


def of_multicell(path, seed):
    """Run the import; return the same numbers."""
    scene = mc.import_physicell(path).scene.with_changes({"seed": seed})
    result, made = mc.run(scene, report=False), []
    for frame in result.frames:
        cells = frame.cells.take(~frame.cells.dead)
        at = np.argmin(np.abs(np.asarray(result.history["time"]) - frame.time))
        known = result.history.get("ki67_positive")
        positive = np.nan if known is None else np.asarray(known)[at]
        distance = np.sqrt((cells.position**2).sum(axis=1).mean())
        made.append((len(cells), cells.volume.mean(), positive, distance, (cells.kind == 1).sum()))
    return np.array(made)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("program", type=Path)
    parser.add_argument("--models", default=",".join(MODELS))
    options = parser.parse_args()
    words = ("cells", "volume, um^3", "Ki67+", "rms distance, um", "movers")
    for name in options.models.split(","):
        with tempfile.TemporaryDirectory() as folder:
            paths = [write(Path(folder) / str(seed), name, seed) for seed in (1, 2)]
            theirs = [of_physicell(options.program.resolve(), path) for path in paths]
            ours = [of_multicell(paths[0], seed) for seed in range(3)]
        hours = MODELS[name][2] * np.arange(len(ours[0]))
        print(f"{name}, after {', '.join(map(str, hours))} h")
        for who, found in (("PhysiCell", theirs), ("multicell", ours)):
            for place, word in enumerate(words):
                rows = " | ".join(", ".join(f"{x:.4g}" for x in one[:, place]) for one in found)
                print(f"  {who} {word}: {rows}", flush=True)


if __name__ == "__main__":
    main()
