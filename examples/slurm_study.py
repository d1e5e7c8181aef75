"""A study on a Slurm cluster: jobs as Dask workers
================================================

Problem
    A study of more runs than one machine has cores for; here EMT6 spheroids in twelve media,
    five seeds each.
Scaling
    One process for each core of a job, with one thread; a run takes one of them.
Cost
    As "multicell study new" predicts, divided by the number of cores that Slurm provides. It is
    not run in the documentation, whose builder has no cluster.
Command
    .. code-block:: sh

        python examples/slurm_study.py study --queue compute --jobs 10 --cores 16
        python examples/slurm_study.py study --queue compute --cores 16 --show   # the job script

Run it where jobs are submitted, in the environment of the jobs. It needs
``pip install "multicell[cluster]"``. The folder of the study must be on a file system that all
nodes share. Nothing is lost when the time of a job is over, or when this process is killed: start
it again to continue the study.
"""

import argparse
import sys
from pathlib import Path

import multicell as mc

VARY = {
    "nutrients.oxygen.boundary": "0.07,0.14,0.28 mM",
    "nutrients.glucose.boundary": "0.8,1.8,5.5,16.5 mM",
}
# Dask would profile a worker a hundred times a second
QUIET = ["export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False"]


def cluster(queue, cores, memory, walltime, interface=None, account=None):
    """Return a cluster whose jobs have one process for each core, with one thread each.

    Parameters
    ----------
    queue, account, walltime, memory
        As Slurm knows them, for each job, such as ``"compute"``, ``"24:00:00"``, ``"64 GB"``.
    cores
        Of each job.
    interface
        Network that nodes see each other by, such as ``"ib0"``; by default the usual one.
    """
    import dask
    from dask_jobqueue import SLURMCluster

    # only whoever has these certificates may have anything run
    certificates = Path("certificates").absolute()
    certificates.mkdir(mode=0o700, exist_ok=True)
    # a run may keep its worker from answering for the length of a coupling step
    dask.config.set({"distributed.scheduler.worker-ttl": None})
    return SLURMCluster(
        queue=queue,
        account=account,
        cores=cores,
        processes=cores,
        memory=memory,
        walltime=walltime,
        interface=interface,
        security=True,
        shared_temp_directory=str(certificates),
        # this Python, and the packages of runs are loaded before the first one
        python=sys.executable,
        worker_extra_args=["--preload", "multicell.studies.workers"],
        job_script_prologue=QUIET,
        # no pages in a browser, on any free port
        scheduler_options={"dashboard": False, "dashboard_address": ":0"},
    )


def main(arguments=None):
    """Run the study of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--queue", required=True)
    parser.add_argument("--account")
    parser.add_argument("--jobs", type=int, default=4)
    parser.add_argument("--cores", type=int, default=16)
    parser.add_argument("--memory", default="32 GB")
    parser.add_argument("--walltime", default="24:00:00")
    parser.add_argument("--interface")
    parser.add_argument("--show", action="store_true", help="print the script of a job only")
    given = parser.parse_args(arguments)
    with cluster(
        given.queue, given.cores, given.memory, given.walltime, given.interface, given.account
    ) as jobs:
        if given.show:
            print(jobs.job_script())
            return None
        study = mc.study("emt6", vary=VARY, seeds=5, output=given.folder)
        return carried_out(study, jobs, given.jobs)


def carried_out(study, jobs, count):
    """Submit jobs, wait for the first worker, and run a study by all that come."""
    from distributed import Client

    jobs.scale(jobs=count)
    with Client(jobs) as client:
        client.wait_for_workers(1)
    outcomes = study.run(scheduler=jobs)
    done = sum(outcome.state == "done" for outcome in outcomes)
    print(f"{done} of {len(outcomes)} runs are done: multicell study status {study.folder}")
    return study


if __name__ == "__main__":
    main()
