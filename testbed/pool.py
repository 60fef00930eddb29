"""Blocks worked on in this process or in several, and what becomes of them when a process dies.

Whatever is a `concurrent.futures.Executor` will do: processes of this machine (`Workers`), a cluster (`testbed.cluster`), threads in a
test. Neighbouring blocks are handed out together, as many as take about a second: then it does not matter what handing over costs.
A task's size is found on the way and changes no number, since a block stays a block.

Processes are started afresh (spawn: a physics client or a lock of this process is no business of theirs), with one thread each
for linear algebra, and end with this process however it ends: each listens on a pipe that only this process can hold open.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from math import ceil
from multiprocessing.connection import Connection
from time import perf_counter

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

TASK_S = 1.0  # that a task should last
MOST_BLOCKS = 512  # in a task, however fast they are

ExecutorFactory = Callable[[int], Executor]
Made = list[tuple[Block, BlockResult]]
Results = Generator[Made, None, None]


class CannotStart(RuntimeError):
    """No worker process came up at all."""


class WorkerDied(Exception):
    """What an executor says of a task whose process died, where it goes on itself (BrokenExecutor: where it doesn't)."""


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
    """Every block with its result, as they are done, those of a task together. Blocks of one point should be neighbours.

    With one job and no executor of your own, in this process: then a crash in native code ends it. What `run_block` raises ends it
    all and is raised here; a trial in which a worker process dies is a failure in its block's result. `run_block` must be importable
    by name in the workers. CannotStart where no worker comes up.
    """
    if jobs == 1 and executors is None:
        return _here(blocks, run_block)
    return _Pool(run_block, max(1, min(jobs, len(blocks))), executors or Workers).results(blocks)


def _here(blocks: Sequence[Block], run_block: RunBlock) -> Results:
    queue = _Queue(blocks)
    try:
        while queue:
            done: Made = []
            begun = perf_counter()
            try:
                for block in queue.take(1):
                    done.append((block, run_block(block)))
            except BaseException:  # Ctrl-C among them
                if done:
                    yield done
                raise
            queue.learn(done, perf_counter() - begun)
            yield done
    finally:
        worker.close()


def run_task(run_block: RunBlock, blocks: Sequence[Block]) -> tuple[list[BlockResult], float]:
    """In a worker: the results of blocks, and how long they took, s. Fewer where one raises; it raises when it comes first."""
    begun, found = perf_counter(), []
    for block in blocks:
        try:
            found.append(run_block(block))
        except Exception:
            if not found:
                raise
            break
    return found, perf_counter() - begun


class _Queue:
    """Blocks waiting, handed out in tasks of one point that take about `TASK_S`."""

    def __init__(self, blocks: Sequence[Block], most: int | None = None) -> None:
        self._waiting, self._most, self._pace = deque(blocks), most or MOST_BLOCKS, TASK_S

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def take(self, jobs: int) -> list[Block]:
        """The next task; towards the end they get smaller, so that the jobs end together."""
        size = min(self._most, max(1, ceil(TASK_S / self._pace)), ceil(len(self._waiting) / (2 * jobs)))
        task = [self._waiting.popleft()]
        while self._waiting and len(task) < size and _alike(task[0], self._waiting[0]):
            task.append(self._waiting.popleft())
        return task

    def back(self, blocks: Sequence[Block]) -> None:
        """Blocks that were handed out and not worked on come first again."""
        self._waiting.extendleft(reversed(blocks))

    def learn(self, done: Sequence[object], seconds: float) -> None:
        """How long blocks take: as long as those just done."""
        if done:
            self._pace = max(seconds / len(done), TASK_S / MOST_BLOCKS)


def _alike(a: Block, b: Block) -> bool:
    """Whether two blocks may be worked on, and kept, together."""
    return (a.point, a.only) == (b.point, b.only)


class _Pool:
    """Keeps an executor busy, and replaces it when it breaks."""

    def __init__(self, run_block: RunBlock, jobs: int, executors: ExecutorFactory) -> None:
        self._run_block, self._jobs, self._executors = run_block, jobs, executors

    def results(self, blocks: Sequence[Block]) -> Results:
        queue = _Queue(blocks)
        while queue:
            suspects: list[Block] = []
            for task, found in self._while_it_lasts(queue, self._jobs, ahead=2 * self._jobs):
                if found is None:
                    suspects += task
                else:
                    yield list(zip(task, found, strict=True))
            # a dead process takes down all tasks that were on their way; one block at a time, each shows whether it was the one
            for block, result in self._one_at_a_time(suspects):
                yield [(block, result or self._trial_by_trial(block))]

    def _one_at_a_time(self, blocks: Sequence[Block]) -> Iterator[tuple[Block, BlockResult | None]]:
        """Each block with none beside it: None for one in which the process dies."""
        queue = _Queue(blocks, most=1)
        while queue:
            for task, found in self._while_it_lasts(queue, 1, ahead=1):
                yield task[0], found[0] if found else None

    def _trial_by_trial(self, block: Block) -> BlockResult:
        """A block in which the process dies: the trials that it dies in are failures, the others have their results."""
        if len(block.trials) == 1:
            return _died(block)
        alone = [block.alone(trial) for trial in block.trials]
        return joined([result or _died(one) for one, result in self._one_at_a_time(alone)])

    def _while_it_lasts(self, queue: _Queue, jobs: int, ahead: int) -> Iterator[tuple[list[Block], list[BlockResult] | None]]:
        """Work off the queue, `ahead` tasks at a time.

        None for a task in which a process died. Once the executor is broken by it: for each task that was under way, then stop.
        """
        executor = self._executors(jobs)
        under_way: dict[Future[tuple[list[BlockResult], float]], list[Block]] = {}
        finished = broken = False
        try:
            up = executor.submit(_ready)
            while under_way or (queue and not broken):
                while queue and not broken and len(under_way) < ahead:
                    task = queue.take(jobs)
                    try:
                        under_way[executor.submit(run_task, self._run_block, task)] = task
                    except BrokenExecutor:
                        queue.back(task)
                        broken = True
                for future in wait(under_way, return_when=FIRST_COMPLETED).done if under_way else ():
                    task = under_way.pop(future)
                    try:
                        found, seconds = future.result()
                    except WorkerDied:
                        yield task, None
                    except BrokenExecutor:
                        broken = True
                        yield task, None
                    else:
                        queue.learn(found, seconds)
                        queue.back(task[len(found) :])
                        yield task[: len(found)], found
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
