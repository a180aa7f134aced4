"""Running a campaign: what its folder does not hold yet, on this machine or on others."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..results.database import Result
from ..results.store import Store
from .campaign import Campaign, Tasks
from .execution import in_process, in_processes


@dataclass(frozen=True)
class CampaignProgress:
    """How far a campaign has come.

    Attributes
    ----------
    campaign, store : what is run, and the open folder with what is stored of it.
    remarks : what its user should know: unusual values, estimators left out, unused results.
    total, done : number of results that were missing when it began, and of those since stored.
    new : those stored since the last step.
    workers : number of workers of the cluster; None on this machine.
    waiting : for what it waits, a sentence or "".
    """

    campaign: Campaign
    store: Store
    remarks: Sequence[str]
    total: int
    done: int = 0
    new: Sequence[Result] = ()
    workers: int | None = None
    waiting: str = ""


class CampaignOutcome(NamedTuple):
    """How a campaign ended: its open folder, whether it was stopped, what gave no result."""

    store: Store
    interrupted: bool
    missing: int


def run(
    work: Campaign,
    jobs: int | None = None,
    cluster: str | None = None,
    progress: Callable[[CampaignProgress], None] = lambda step: None,
) -> CampaignOutcome:
    """Run what a campaign's folder does not hold yet. Ctrl-C while runs are running ends it early.

    Raise StoreError or CampaignError as :meth:`Campaign.open`, ExecutionError if the runs cannot be
    run at all.

    Parameters
    ----------
    jobs : number of worker processes, by default one for each processor; 0: none, all runs are run
        in this process, without time limit.
    cluster : address of the Dask scheduler to run on instead.
    progress : is called at every step, first when the folder is open.
    """
    store, remarks = work.open()
    try:
        tasks = work.tasks(store)
        step = CampaignProgress(work, store, remarks, tasks.results)
        progress(step)
        if tasks.results:

            def told(batch: list[Result]) -> None:
                nonlocal step
                step = replace(step, done=step.done + len(batch), new=batch)
                progress(step)

            def told_of_workers(workers: int, waiting: str) -> None:
                nonlocal step
                step = replace(step, new=(), workers=workers, waiting=waiting)
                progress(step)

            results = _engine(tasks, jobs, cluster, work.limit, told_of_workers)

            try:
                execute(results, store, told)
            except KeyboardInterrupt:
                return CampaignOutcome(store, True, 0)
        return CampaignOutcome(store, False, work.missing(store))
    except BaseException:
        store.close()  # or no other process could use the folder as long as this process lives
        raise


def _engine(
    tasks: Tasks,
    jobs: int | None,
    cluster: str | None,
    limit: float,
    tell: Callable[[int, str], None],
) -> Generator[list[Result]]:
    """Return the results of tasks as they come, from where they are run."""
    if cluster:
        from .cluster import on_cluster  # not at the top: Dask is not always there

        return on_cluster(tasks, cluster, limit, tell)
    if jobs == 0:
        return in_process(tasks)
    return in_processes(tasks, jobs or os.cpu_count() or 1, limit)


def execute(
    results: Generator[list[Result]], store: Store, progress: Callable[[list[Result]], None]
) -> None:
    """Store the results of an engine as they come, and tell ``progress`` of them.

    However it ends, the engine is closed: nothing runs on.
    """
    with contextlib.closing(results):
        for batch in results:
            store.add(batch)
            progress(batch)
