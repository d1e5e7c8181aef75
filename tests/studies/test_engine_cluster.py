"""Studies on a Dask cluster of which only the address is known."""

import gc
import json
import os

import psutil
import pytest
from clusters import PACKAGE, Cluster
from stored import assert_same_bits
from studied import CHANGES, alive, gone, runs_of, short_runs, started, statuses, wait_for

import multicell as mc
from multicell.calibration.fitting.pool import Pool
from multicell.errors import ClusterError
from multicell.studies.engine import run_study
from multicell.studies.runs import MODEL_VERSION
from multicell.studies.workers import _sees, check_folder, check_workers, own_versions, workers


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with Cluster(tmp_path_factory.mktemp("cluster")) as made:
        yield made


def refused(runs, folder, cluster):
    with pytest.raises(ClusterError) as caught:
        run_study(runs, folder, scheduler=cluster.address)
    assert caught.value.exit_code == 2
    assert not any((folder / "runs").iterdir())
    return str(caught.value)


def ended(*processes):
    for process in processes:
        process.terminate()
        process.wait(20)


@pytest.mark.slow
def test_workers_are_used_that_others_have_started(cluster, tmp_path):
    said = refused(short_runs(1), tmp_path, cluster)
    assert "has no workers" in said
    assert "dask worker tcp://127.0.0.1:" in said
    worker = cluster.worker("--nworkers", "2")
    runs = short_runs(3)
    outcomes = run_study(runs, tmp_path, scheduler=cluster.address)
    assert [(o.state, o.reused) for o in outcomes] == [("done", False)] * 3
    mc.run(runs[0].scene, output=tmp_path / "alone", report=False, threads=1)
    assert_same_bits(tmp_path / "alone", tmp_path / "runs" / runs[0].name)
    ended(worker)


@pytest.mark.slow
def test_workers_that_cannot_run_scenes_as_we_do_are_named(cluster, tmp_path):
    runs, study = short_runs(1), tmp_path / "study"
    hidden = "import sys; sys.modules['multicell'] = None"
    (tmp_path / "sitecustomize.py").write_text(hidden)
    worker = cluster.worker(path=str(tmp_path))
    said = refused(runs, study, cluster)
    assert "has no multicell" in said
    assert f"but this process has multicell {mc.__version__}" in said
    ended(worker)
    worker = cluster.worker("--nthreads", "3")
    said = refused(runs, study, cluster)
    assert "has 3 threads" in said
    assert "'--nthreads 1'" in said
    ended(worker)


@pytest.fixture
def another_version(tmp_path):
    """Return the path with which a worker has another version of the model, and of NumPy."""
    place = tmp_path / "another"
    place.mkdir()
    (place / "sitecustomize.py").write_text(
        "import multicell.studies.runs as runs, multicell.results.folder as folder\n"
        "runs.MODEL_VERSION, own = 99, folder.package_version\n"
        "folder.package_version = lambda *x: '2.3.5' if x == ('numpy',) else own(*x)\n"
    )
    return os.pathsep.join([str(place), PACKAGE])


@pytest.mark.harness
@pytest.mark.slow
def test_a_worker_of_another_version_that_joins_later_computes_nothing(another_version, tmp_path):
    runs, seen = short_runs(12), []
    with Cluster(tmp_path) as cluster:
        cluster.worker()

        def joins(outcome):
            seen.append(outcome)
            if len(seen) == 1:
                cluster.worker(path=another_version)

        outcomes = run_study(runs, tmp_path / "study", scheduler=cluster.address, progress=joins)
        assert [(o.state, dict(o.made)) for o in outcomes] == [("done", own_versions())] * 12
        for run in runs:
            summary = json.loads((tmp_path / "study/runs" / run.name / "summary.json").read_text())
            assert summary["versions"]["numpy"] == own_versions()["numpy"]


@pytest.mark.slow
def test_where_no_worker_of_this_version_is_left_a_study_says_so(another_version, tmp_path):
    with Cluster(tmp_path) as cluster:
        good = cluster.worker()

        def leaves(outcome):
            ended(good)
            cluster.worker(path=another_version)

        with pytest.raises(ClusterError, match=r"has numpy 2\.3\.5, but.* and no other worker"):
            run_study(short_runs(3), tmp_path / "study", scheduler=cluster.address, progress=leaves)


@pytest.mark.slow
def test_calls_of_a_fit_are_made_by_workers_of_this_version(another_version, tmp_path):
    with Cluster(tmp_path) as cluster:
        cluster.worker()
        with workers(None, cluster.address) as client:
            cluster.worker(path=another_version)
            wait_for(lambda: len(client.nthreads()) == 2)
            calls = [(k, eval, (MODEL,)) for k in range(20)]
            found = dict(Pool(lambda: client).results(calls))
    assert found == dict.fromkeys(range(20), MODEL_VERSION)


MODEL = "__import__('multicell.studies.runs', fromlist=['x']).MODEL_VERSION"


class Other:
    """A client of one worker that answers otherwise than this process would."""

    def __init__(self, answer):
        self.answer = answer

    def nthreads(self):
        return {"tcp://10.0.0.7:4000": 1}

    def run(self, function, *arguments, **options):
        return {"tcp://10.0.0.7:4000": self.answer}


OWN = own_versions()


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (ImportError("broken"), r"cannot load multicell \(ImportError: broken\)"),
        ({**OWN, "multicell": "0.0.1"}, r"has multicell 0\.0\.1, but"),
        ({**OWN, "model version": "99"}, r"has model version 99, but this process has multicell"),
        ({**OWN, "Python": "3.9"}, r"has Python 3\.9, but this process has multicell"),
    ],
)
def test_workers_with_other_versions_are_named(answer, problem):
    with pytest.raises(ClusterError, match=problem):
        check_workers(Other(answer), "tcp://10.0.0.7:8786")
    check_workers(Other(OWN), "tcp://10.0.0.7:8786")


class Elsewhere:
    """Workers of another machine."""

    def __init__(self, said):
        self.said = said

    def run(self, function, path):
        assert function(path) == ""  # here it is seen
        return {"tcp://10.0.0.7:4000": self.said, "tcp://10.0.0.8:4000": self.said}


def test_workers_that_do_not_see_the_folder_are_named(tmp_path):
    said = _sees(str(tmp_path / "other" / "mark"))
    assert "No such file or directory" in said
    with pytest.raises(ClusterError, match=r"worker tcp://10.0.0.7:4000 cannot use .* and 1 more"):
        check_folder(Elsewhere(said), tmp_path)
    assert list(tmp_path.iterdir()) == []
    other = tmp_path / ".visible-1"
    other.write_text("2")
    assert "reads something else" in _sees(str(other))
    other.unlink()
    check_folder(Elsewhere(""), tmp_path)
    assert list(tmp_path.iterdir()) == []


LONG = "20 h"


def states(runs, folder):
    return [found.state for found in statuses(runs, folder)]


@pytest.mark.slow
def test_whatever_is_killed_of_a_cluster_nobody_goes_on_alone(tmp_path):
    """The scheduler, the nanny of a worker, and the process that wants the runs."""
    (run,) = runs = runs_of(1, changes={**CHANGES, "duration": LONG})
    with Cluster(tmp_path) as cluster:
        nanny = cluster.worker("--nworkers", "1", "--nanny")
        # who wants the run goes
        client = started(tmp_path / "study", 1, cluster.address, LONG)
        wait_for(lambda: states(runs, tmp_path / "study") == ["running"])
        client.kill()
        client.communicate()
        wait_for(lambda: states(runs, tmp_path / "study") == ["partial"], within=6.0)
        # the nanny goes, and its worker with it
        client = started(tmp_path / "study", 1, cluster.address, LONG)
        wait_for(lambda: states(runs, tmp_path / "study") == ["running"])
        workers = psutil.Process(nanny.pid).children(recursive=True)
        nanny.kill()
        assert gone(workers), [x.cmdline() for x in workers if alive(x)]
        # another worker comes, and then the scheduler goes
        nanny = cluster.worker("--nworkers", "1", "--nanny", "--death-timeout", "5")
        wait_for(lambda: states(runs, tmp_path / "study") == ["running"])
        workers = psutil.Process(nanny.pid).children(recursive=True)
        cluster.main.kill()
        text, _ = client.communicate(timeout=60)
        assert client.returncode == 3, text
        assert text.splitlines()[-1].startswith("Error: the scheduler has gone. All that")
        assert "Traceback" not in text
        wait_for(lambda: states(runs, tmp_path / "study") == ["partial"], within=10.0)
    (outcome,) = run_study(runs, tmp_path / "study", cores=1)
    assert outcome.state == "done"
    mc.run(run.scene, output=tmp_path / "whole", report=False, threads=1)
    assert_same_bits(tmp_path / "whole", tmp_path / "study" / "runs" / run.name)


def test_a_client_that_cannot_be_made_is_closed_at_once():
    """Left to the garbage collector one was closed while the next held a lock that both need."""
    from distributed import Client

    with pytest.raises(ClusterError, match="does not answer"), workers(None, "tcp://127.0.0.1:9"):
        pass
    clients = [thing for thing in gc.get_objects() if type(thing) is Client]
    assert {client.status for client in clients} <= {"closed"}
