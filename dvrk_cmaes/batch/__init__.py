"""A folder of frames, unattended: spread over processes or a cluster, and survived.

`run_batch` does the frames that have no result yet, `merge_shards` gathers what several machines made of one session,
`finish` makes the tables and the page. From the bottom up: `digests` and `manifest` (what the results were made from),
`worker` (one frame, in whatever process), `pool` and `cluster` (many frames), `worklist` and `folder` (which, and
where), `run` and `merge`.
"""

from __future__ import annotations

from dvrk_cmaes.batch.cluster import dask_executor
from dvrk_cmaes.batch.merge import merge_shards
from dvrk_cmaes.batch.run import BatchSummary, Watcher, finish, run_batch
from dvrk_cmaes.batch.worker import BatchSetup, FrameOutcome
from dvrk_cmaes.batch.worklist import Shard

__all__ = [
    "BatchSetup",
    "BatchSummary",
    "FrameOutcome",
    "Shard",
    "Watcher",
    "dask_executor",
    "finish",
    "merge_shards",
    "run_batch",
]
