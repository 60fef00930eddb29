"""A cluster as an executor: a dask scheduler that runs already, or one that asks Slurm for workers.

    tcp://host:8786, tls://...    a scheduler with workers, each with the testbed installed (`pip install '.[cluster]'`)
    slurm:profile.yaml            jobs of a Slurm queue: the file holds what `dask_jobqueue.SLURMCluster` is told (queue, cores, memory,
                                  walltime, ...), `jobs`, how many to ask for, and `wait_s`, how long for the first

A worker that dies costs nothing: the scheduler hands its tasks to others. A task in which several die is told as `pool.WorkerDied`, and
its trials are tried one by one. Workers with other code or other libraries than this process are refused, since their figures would
differ. Summaries come back as a task's result; recordings are written where they belong, or, where workers can't see the output folder,
to a shared place that fsspec knows (`s3://bucket/path`, `file:///mnt/path`), from which this process brings them home.
"""

from __future__ import annotations

import shutil
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any
from uuid import uuid4

from ruamel.yaml import YAML, YAMLError
from threadpoolctl import threadpool_limits

from testbed import archive
from testbed.manifest import made_with
from testbed.pool import CannotStart, WorkerDied, run_task
from testbed.worker import Block, BlockResult

EXTRA = "pip install 'warehouse-radio-testbed[cluster]'"
SCHEMES = ("tcp://", "tls://", "ws://", "wss://")
ANSWER_S, WORKER_S = 15.0, 120.0  # that a scheduler may take to answer, and to have a worker

_one_at_a_time = Lock()  # a worker process holds one world, however many threads it was given


class ClusterError(CannotStart):
    """A cluster that can't be used, or went away: in one sentence. What was finished is kept."""


class Cluster:
    """A scheduler's workers. Called with a number of jobs it gives an executor on them, as `testbed.pool` wants it.

    jobs : worker processes when it was made; shared : where recordings go, "" for straight into the output folder
    """

    def __init__(self, client: Any, packages: frozenset[str], shared: str = "") -> None:
        self._client, self._packages = client, packages
        self._expected = made_with(packages)
        self._shared = f"{shared.rstrip('/')}/testbed-{uuid4().hex[:12]}" if shared else ""
        self.jobs = max(1, len(client.nthreads()))

    def __call__(self, jobs: int) -> Executor:
        return _Tasks(self._client, (self._packages, self._expected, self._shared))

    def bring(self, block: Block) -> None:
        """Fetch the recordings of a block that is done from the shared place into its folder. StoreError where that fails."""
        if not self._shared or block.folder is None:
            return
        for trial in block.trials:
            place = archive.place(block.folder, block.point, trial)
            fetch(f"{self._shared}/{place.relative_to(block.folder).as_posix()}", place)

    def close(self) -> None:
        """Leave nothing in the shared place."""
        if self._shared:
            files, path = _files(self._shared)
            if files.exists(path):
                files.rm(path, recursive=True)


class _Tasks(Executor):
    """Tasks on a client's cluster, with its troubles in the words of `testbed.pool`."""

    def __init__(self, client: Any, terms: tuple[frozenset[str], Mapping[str, str], str]) -> None:
        self._inner, self._terms = client.get_executor(pure=False), terms

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        asked = (fn, args) if fn is not run_task else (_run_task, (*args, self._terms))
        theirs, ours = self._inner.submit(asked[0], *asked[1], **kwargs), Future[Any]()
        theirs.add_done_callback(lambda done: _copy(done, ours))
        return ours

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._inner.shutdown(wait=wait)


def _copy(done: Future[Any], ours: Future[Any]) -> None:
    from distributed import KilledWorker

    try:
        ours.set_result(done.result())
    except KilledWorker as error:
        ours.set_exception(WorkerDied(str(error)))
    except CancelledError:
        ours.set_exception(ClusterError("the cluster's scheduler has gone; what was finished is kept: continue with --resume"))
    except BaseException as error:
        ours.set_exception(error)


# ---------------------------------------------------------------- in a worker


def _run_task(run_block: Any, blocks: Sequence[Block], terms: tuple[frozenset[str], Mapping[str, str], str]) -> Any:
    """`pool.run_task` in a worker of the cluster, once it is clear that its figures will be the same as here."""
    packages, expected, shared = terms
    _check_versions(packages, expected)
    with _one_at_a_time, threadpool_limits(1):
        if shared:
            return _run_apart(run_block, blocks, shared)
        _check_folder(blocks[0])
        return run_task(run_block, blocks)


def _check_versions(packages: frozenset[str], expected: Mapping[str, str]) -> None:
    mine = made_with(packages)
    for name, wanted in expected.items():
        if mine.get(name) != wanted:
            what = "code" if name == "code" else f"{name} {mine.get(name)}"
            other = "the one that this run started with" if name == "code" else wanted
            raise ClusterError(f"the worker on {socket.gethostname()} has other {what}, not {other}: install the same there")


def _check_folder(block: Block) -> None:
    if block.folder is not None and (block.keep or block.keep_failed) and not (block.folder / "manifest.json").is_file():
        raise ClusterError(
            f"the worker on {socket.gethostname()} can't see {block.folder}: choose --out on a disk that all share, "
            "name one for recordings with --shared, or keep none (--keep none)"
        )


def _run_apart(run_block: Any, blocks: Sequence[Block], shared: str) -> tuple[list[BlockResult], float]:
    """Run blocks with their recordings in a folder of this machine, and hand these over."""
    with TemporaryDirectory() as rough:
        home = Path(rough)
        found = run_task(run_block, [replace(block, folder=home) if block.folder else block for block in blocks])
        for path in sorted(home.rglob("*")):
            if path.is_file():
                files, there = _files(f"{shared}/{path.relative_to(home).as_posix()}")
                files.makedirs(there.rpartition("/")[0], exist_ok=True)
                files.put_file(str(path), there)
        return found


# ---------------------------------------------------------------- the shared place


def _files(url: str) -> tuple[Any, str]:
    import fsspec

    return fsspec.core.url_to_fs(url)


def fetch(url: str, place: Path) -> None:
    """Bring a recording's folder home as `place`, whole or not at all; nothing where there is none. StoreError where that fails."""
    files, there = _files(url)
    rough = place.with_name(f".{place.name}.fetched.part")
    try:
        if not files.exists(there):
            return
        for name in files.find(there):
            mine = rough / name[len(there) :].lstrip("/")
            mine.parent.mkdir(parents=True, exist_ok=True)
            files.get_file(name, str(mine))
        shutil.rmtree(place, ignore_errors=True)
        rough.rename(place)
        files.rm(there, recursive=True)
    except OSError as error:
        shutil.rmtree(rough, ignore_errors=True)
        raise archive.StoreError(f"can't fetch the recording {url}: {error.strerror or error}") from error


# ---------------------------------------------------------------- finding a cluster


@contextmanager
def connected(address: str, packages: frozenset[str], shared: str = "") -> Iterator[Cluster]:
    """The cluster at an address, let go of in the end. ClusterError where there is none, or none with a worker.

    packages : whose code the figures come from (`testbed.manifest.packages`), and has to be the same on all workers
    """
    if not address.startswith((*SCHEMES, "slurm:")):
        raise ClusterError(f"no cluster {address!r}: it is tcp://HOST:PORT of a dask scheduler, or slurm:PROFILE.yaml")
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(f"a cluster needs dask: {EXTRA}") from None
    if address.startswith("slurm:"):
        with _slurm(Path(address.removeprefix("slurm:"))) as (scheduler, wait_s):
            yield from _with_client(Client, scheduler, wait_s, packages, shared)
    else:
        yield from _with_client(Client, address, WORKER_S, packages, shared)


def _with_client(make: Any, where: Any, wait_s: float, packages: frozenset[str], shared: str) -> Iterator[Cluster]:
    try:
        client = make(where, timeout=ANSWER_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(f"no scheduler answers at {where} within {ANSWER_S:g} s ({error})") from None
    try:
        try:
            client.wait_for_workers(1, timeout=wait_s)
        except TimeoutError:
            raise ClusterError(f"no worker came to {where} within {wait_s:g} s") from None
        cluster = Cluster(client, packages, shared)
        try:
            yield cluster
        finally:
            cluster.close()
    finally:
        client.close()


@contextmanager
def _slurm(path: Path) -> Iterator[tuple[Any, float]]:
    """A scheduler of our own whose workers are jobs of Slurm, as a profile says."""
    profile = profile_of(path)
    jobs, wait_s = profile.pop("jobs", 1), profile.pop("wait_s", 3600.0)
    try:
        from dask_jobqueue.slurm import SLURMCluster
    except ImportError:
        raise ClusterError(f"Slurm needs dask-jobqueue: {EXTRA}") from None
    try:
        cluster = SLURMCluster(**profile)
    except (TypeError, ValueError) as error:
        raise ClusterError(f"{path}: {error}") from None
    try:
        cluster.scale(jobs=jobs)
        yield cluster, wait_s
    finally:
        cluster.close()


def profile_of(path: Path) -> dict[str, Any]:
    """What a profile says. ClusterError, naming the file, for one that can't be read or is no mapping."""
    try:
        found = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ClusterError(f"{path} can't be read: {error.strerror}") from None
    except YAMLError as error:
        raise ClusterError(f"{path} is no YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(found, dict) or not all(isinstance(key, str) for key in found):
        raise ClusterError(f"{path}: a mapping is wanted, as in {{queue: short, cores: 1, memory: 2GB, jobs: 20}}")
    for name, kind in (("jobs", int), ("wait_s", int | float)):
        if name in found and not (isinstance(found[name], kind) and found[name] > 0):
            raise ClusterError(f"{path}: {name} is a number above 0, not {found[name]!r}")
    return found
