"""Motion of two JKR cells, with the equation handed to SciPy."""

from example_programs import load

SUBJECT, SOURCE = "motion", "SciPy"


def test_two_jkr_cells_relax(compare):
    example = load("two_cells")
    times, distance = example.distances(example.setup("cvode", atol=1e-6, rtol=1e-8))
    off = abs(distance - example.reference(times)).max()
    compare.deviation("two JKR cells relax, `cvode` at 10⁻⁶ µm", "Radau at 10⁻¹⁰", off, 1e-4, "µm")
