"""The script that runs a command of `mvedge` on a SLURM cluster."""

from collections.abc import Sequence

_SCRIPT = '''\
"""Runs `mvedge {command}` with workers that SLURM starts.

Start it where jobs are submitted. It needs `pip install 'mvedge_jax[cluster]' dask-jobqueue`.
"""

import sys

from dask_jobqueue import SLURMCluster
from mvedge_jax.cli import main

JOBS = 8
COMMAND = [
{words}
]

if __name__ == "__main__":
    cluster = SLURMCluster(
        cores=1,  # threads of a worker: it estimates one light field at a time,
        job_cpu=2,  # on two processor cores
        processes=1,
        memory="8GB",
        walltime="02:00:00",
        # queue="gpu",
        # job_extra_directives=["--gres=gpu:1"],  # a worker per device
        # job_script_prologue=["export MVEDGE_CACHE=/scratch/mvedge"],
    )
    with cluster:
        cluster.scale(jobs=JOBS)
        sys.exit(main([*COMMAND, "--scheduler", cluster.scheduler_address]))
'''


def slurm_script(words: Sequence[str]) -> str:
    """A Python script that runs words of the command line on a cluster of dask-jobqueue.

    Number of jobs, memory and time stand in it, to be edited.
    """
    lines = "\n".join(f"    {word!r}," for word in words)
    return _SCRIPT.format(command=words[0], words=lines)
