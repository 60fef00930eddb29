"""Blocks worked on in this process or in several, and what becomes of them when a process dies.

Processes are started afresh (spawn: a physics client or a lock of this process is no business of theirs), with one thread each
for linear algebra, and end with this process however it ends: each listens on a pipe that only this process can hold open.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing.connection import Connection

from threadpoolctl import threadpool_limits

from testbed import worker
from testbed.worker import Block, BlockResult, Failure, RunBlock, joined

_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)

ExecutorFactory = Callable[[int], Executor]
Results = Generator[tuple[Block, BlockResult], None, None]


class CannotStart(RuntimeError):
    """No worker process came up at all."""


def cores() -> int:
    """How many processes this one may run at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Within: this process and those that it starts use one thread for linear algebra."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class Workers(ProcessPoolExecutor):
    """`jobs` spawned processes, which `stop` ends at once."""

    def __init__(self, jobs: int) -> None:
        context = multiprocessing.get_context("spawn")
        listens, self._lifeline = context.Pipe(duplex=False)
        super().__init__(jobs, mp_context=context, initializer=_begin, initargs=(listens,))

    def stop(self, at_once: bool) -> None:
        """End the processes and wait for that: when they have finished what they do, or whatever they are doing."""
        if at_once:
            self._lifeline.close()
        self.shutdown(wait=True, cancel_futures=True)
        self._lifeline.close()


def _begin(lifeline: Connection) -> None:
    """A worker's first act: leave Ctrl-C to the main process, and die with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    try:
        lifeline.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)


def _ready() -> bool:
    return True


# ---------------------------------------------------------------- working


def results(blocks: Sequence[Block], run_block: RunBlock, jobs: int, executors: ExecutorFactory | None = None) -> Results:
    """Every block with its result, as they are done. Blocks of one point should be neighbours: a worker holds one world.

    With one job and no executor of your own, in this process. What `run_block` raises ends it all and is raised here; a trial
    in which a worker process dies is a failure in its block's result. `run_block` must be importable by name in the workers.
    CannotStart where no worker comes up.
    """
    if jobs == 1 and executors is None:
        return _here(blocks, run_block)
    return _Pool(run_block, max(1, min(jobs, len(blocks))), executors or Workers).results(blocks)


def _here(blocks: Sequence[Block], run_block: RunBlock) -> Results:
    try:
        for block in blocks:
            yield block, run_block(block)
    finally:
        worker.close()


class _Pool:
    """Keeps an executor busy, and replaces it when it breaks."""

    def __init__(self, run_block: RunBlock, jobs: int, executors: ExecutorFactory) -> None:
        self._run_block, self._jobs, self._executors = run_block, jobs, executors

    def results(self, blocks: Sequence[Block]) -> Results:
        waiting = list(reversed(blocks))
        while waiting:
            suspects: list[Block] = []
            for block, result in self._while_it_lasts(waiting, self._jobs, ahead=2 * self._jobs):
                if result is None:
                    suspects.append(block)
                else:
                    yield block, result
            # a dead process takes down all blocks that were on their way; one at a time, each shows whether it was the one
            for block, result in self._one_at_a_time(suspects):
                yield block, result or self._trial_by_trial(block)

    def _one_at_a_time(self, blocks: Sequence[Block]) -> Iterator[tuple[Block, BlockResult | None]]:
        """Each block with none beside it: None for one in which the process dies."""
        waiting = list(reversed(blocks))
        while waiting:
            yield from self._while_it_lasts(waiting, 1, ahead=1)

    def _trial_by_trial(self, block: Block) -> BlockResult:
        """A block in which the process dies: the trials that it dies in are failures, the others have their results."""
        if len(block.trials) == 1:
            return _died(block)
        alone = [block.alone(trial) for trial in block.trials]
        return joined([result or _died(one) for one, result in self._one_at_a_time(alone)])

    def _while_it_lasts(self, waiting: list[Block], jobs: int, ahead: int) -> Iterator[tuple[Block, BlockResult | None]]:
        """Work off `waiting` from its end, `ahead` blocks at a time.

        Once a process has died: None for each block that was under way, then stop.
        """
        executor = self._executors(jobs)
        under_way: dict[Future[BlockResult], Block] = {}
        finished = broken = False
        try:
            up = executor.submit(_ready)
            while under_way or (waiting and not broken):
                while waiting and not broken and len(under_way) < ahead:
                    try:
                        under_way[executor.submit(self._run_block, waiting[-1])] = waiting[-1]
                        waiting.pop()
                    except BrokenExecutor:
                        broken = True
                for future in wait(under_way, return_when=FIRST_COMPLETED).done if under_way else ():
                    block = under_way.pop(future)
                    try:
                        result = future.result()
                    except BrokenExecutor:
                        broken, result = True, None
                    yield block, result
            if broken and (not up.done() or up.exception() is not None):
                raise CannotStart(
                    "the worker processes can't start; a script that runs with more than one job must do so under "
                    "`if __name__ == '__main__':`, and must lie in a file"
                )
            finished = not broken
        finally:
            _stop(executor, at_once=not finished)


def _died(block: Block) -> BlockResult:
    error = "worker died: the process ended without a word (a crash in native code, or killed, as for lack of memory)"
    failures = tuple(Failure(block.point, trial, "", "worker", error, "") for trial in block.trials)
    return BlockResult(block.point, block.trials, failures=failures)


def _stop(executor: Executor, at_once: bool) -> None:
    if isinstance(executor, Workers):
        executor.stop(at_once)
    else:
        executor.shutdown(wait=not at_once, cancel_futures=True)
