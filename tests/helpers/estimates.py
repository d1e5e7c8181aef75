"""The errors that solvers of others estimate for the steps that they are allowed to take."""

from multicell.integrators.restarts import Run


def accepted_steps(monkeypatch):
    """Return a list to which each step adds begin, start, end, stop and its estimated error."""
    taken = []
    step = Run._step

    class Noted:
        def __init__(self, solver):
            self.solver, self.error = solver, None

        def step(self):
            reached, position, self.error = self.solver.step()
            return reached, position, self.error

    def noted(run, solver):
        before = run.elapsed, run.position.copy()
        watched = Noted(solver)
        length = step(run, watched)
        taken.append((*before, run.elapsed, run.position.copy(), watched.error))
        return length

    monkeypatch.setattr(Run, "_step", noted)
    return taken
