"""Execution of a campaign's missing runs, and output of the tables of results."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

from ..results.database import Result
from ..results.folder import Results, write_tables
from ..results.store import Store
from .campaign import Campaign, CampaignError
from .execution import in_process, in_processes
from .plan import Tasks


@dataclass(frozen=True)
class CampaignProgress:
    """Progress of a campaign.

    Attributes
    ----------
    campaign, store : the campaign and its open results folder.
    remarks : remarks for the user on unusual values, estimators left out and unused results.
    total : number of results that were missing at the start.
    done : number of results that have been stored since the start.
    new : results that have been stored since the previous step.
    workers : number of cluster workers; None if the campaign runs on this machine.
    waiting : sentence with the reason for waiting; "" if the campaign is not waiting.
    """

    campaign: Campaign
    store: Store
    remarks: Sequence[str]
    total: int
    done: int = 0
    new: Sequence[Result] = ()
    workers: int | None = None
    waiting: str = ""


class InterruptedCampaign(KeyboardInterrupt):
    """Ctrl-C ended a campaign; ``results`` contains the finished runs."""

    def __init__(self, results: Results) -> None:
        super().__init__()
        self.results = results


class MissingRunsError(CampaignError):
    """Some runs have neither a result nor a recorded failure; ``results`` has all others."""

    def __init__(self, missing: int, results: Results) -> None:
        runs = "1 run" if missing == 1 else f"{missing} runs"
        super().__init__(f"{runs} gave no result; the same command resumes the campaign")
        self.results = results


def fly(
    work: Campaign,
    jobs: int | None = None,
    cluster: str | None = None,
    progress: Callable[[CampaignProgress], None] = lambda step: None,
) -> Results:
    """Execute the missing runs of a campaign, write the tables and return the results.

    The results folder is closed at the end, so that another process can use it.

    Parameters
    ----------
    work : campaign to execute, from :func:`.campaign.planned`.
    jobs : number of worker processes, by default one for each processor; 0: all runs are run in
        this process, without time limit.
    cluster : address of a Dask scheduler; None: run on this machine.
    progress : function that is called at every step, first when the folder is open.

    Raises
    ------
    StoreError, CampaignError
        As in :meth:`Campaign.open`.
    ExecutionError
        If no run can be executed.
    InterruptedCampaign
        If Ctrl-C interrupts the campaign.
    MissingRunsError
        If runs have neither a result nor a recorded failure.
    """
    store, remarks = work.open()
    try:
        interrupted = _run_missing(work, store, remarks, jobs, cluster, progress)
        missing = 0 if interrupted else work.missing(store)
        results = Results(work.folder, store)
        write_tables(results)
    finally:
        store.close()  # or no other process could use the folder as long as this process lives
    results.store = Store(work.folder)
    if interrupted:
        raise InterruptedCampaign(results)
    if missing:
        raise MissingRunsError(missing, results)
    return results


def _run_missing(
    work: Campaign,
    store: Store,
    remarks: Sequence[str],
    jobs: int | None,
    cluster: str | None,
    progress: Callable[[CampaignProgress], None],
) -> bool:
    """Execute the missing runs of an open results folder; return whether Ctrl-C ended them."""
    tasks = work.tasks(store)
    step = CampaignProgress(work, store, remarks, tasks.results)
    progress(step)
    if not tasks.results:
        return False

    def report_results(batch: list[Result]) -> None:
        nonlocal step
        step = replace(step, done=step.done + len(batch), new=batch)
        progress(step)

    def report_workers(workers: int, waiting: str) -> None:
        nonlocal step
        step = replace(step, new=(), workers=workers, waiting=waiting)
        progress(step)

    results = _engine(tasks, jobs, cluster, work.limit, report_workers)
    try:
        execute(results, store, report_results)
    except KeyboardInterrupt:
        return True
    return False


def _engine(
    tasks: Tasks,
    jobs: int | None,
    cluster: str | None,
    limit: float,
    tell: Callable[[int, str], None],
) -> Generator[list[Result]]:
    """Return a generator of results from this process, worker processes or a cluster."""
    if cluster:
        from .cluster import on_cluster  # not at the top: Dask is not always there

        return on_cluster(tasks, cluster, limit, tell)
    if jobs == 0:
        return in_process(tasks)
    return in_processes(tasks, jobs or os.cpu_count() or 1, limit)


def execute(
    results: Generator[list[Result]], store: Store, progress: Callable[[list[Result]], None]
) -> None:
    """Store results as they arrive, and report them to ``progress``.

    The generator ``results`` is closed in all cases, so that no worker process remains.
    """
    with contextlib.closing(results):
        for batch in results:
            store.add(batch)
            progress(batch)
