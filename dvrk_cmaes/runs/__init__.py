"""A folder of frames, unattended: spread over processes, machines or a cluster, and survived.

``run.run_batch`` does the frames that have no result yet, ``merge.merge_shards`` gathers what several machines made of
one session, ``run.finish`` makes the tables and the page. From the bottom up: `digests` and `manifest` (what results
are made from), `worker` (one frame, in whatever process), `pool`, `anywhere` and `cluster` (many frames), `worklist`
and `folder` (which, and where), `summary`, `run` and `merge`.
"""
