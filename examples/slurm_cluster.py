"""Run the pipeline on a SLURM cluster: ``python slurm_cluster.py 11-21 --root /shared/kitti --out /shared/out``.

Needs dask-jobqueue (``pip install dask-jobqueue``), and ``salpcc-pipeline`` in the same version on every node.
Root and output lie on a folder that all nodes share, or at URLs that all of them reach (``s3://bucket/out``): shards
and archives appear there whole, and only paths and small records travel between machines. Jobs may be cancelled or
time out: their GOPs are done again by others. The same command goes on after anything else. Options that are not
listed here, such as ``--keep-movable``, go to ``salpcc-pipeline run sequences``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys

from dask_jobqueue import SLURMCluster


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sequences")
    parser.add_argument("--jobs", type=int, default=16, help="at most so many SLURM jobs")
    parser.add_argument("--cores", type=int, default=16, help="of each job")
    parser.add_argument("--walltime", default="01:00:00")
    arguments, others = parser.parse_known_args()
    # One thread a process: the codec is one thread a scan, and Python holds the rest up.
    with SLURMCluster(
        cores=arguments.cores,
        processes=arguments.cores,
        memory=f"{2 * arguments.cores}GB",
        walltime=arguments.walltime,
        job_script_prologue=["export OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1"],
        worker_extra_args=["--lifetime", "55m", "--lifetime-stagger", "4m"],  # leave before SLURM ends them
    ) as cluster:
        cluster.adapt(minimum_jobs=1, maximum_jobs=arguments.jobs)
        cluster.wait_for_workers(1)
        command = [
            sys.executable,
            "-m",
            "salpcc.pipeline.cli",
            "run",
            "sequences",
            arguments.sequences,
            *others,
        ]
        command += ["--scheduler", cluster.scheduler_address]
        return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
