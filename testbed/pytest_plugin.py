"""The pytest plug-in: scenario files are tests, one for each thing that they expect.

    [tool.pytest.ini_options]
    testbed_scenarios = "scenarios/demo scenarios/smoke"

names the folders (or files), relative to pytest's root, whose YAML files are collected where pytest comes across them; without it
none are. `--testbed-trials`, `--testbed-seed` and `--testbed-jobs` change how they are run. `-p no:testbed` turns all of it off.

This module is loaded at the start of every pytest run on the machine, so it imports the standard library and pytest only; what
scenarios need is in `testbed.pytest_nodes`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from testbed.pytest_nodes import ScenarioFile

ROOTS = "testbed_scenarios"
SHARED = "testbed_shared"  # in the input of pytest-xdist's workers: the folder where they find each other's results

_roots = pytest.StashKey[tuple[Path, ...]]()
_shared = pytest.StashKey[Path]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options and the setting."""
    parser.addini(ROOTS, "folders or files, relative to the root, whose scenarios (*.yaml, *.yml) are collected as tests", type="args")
    group = parser.getgroup("testbed", "scenarios as tests")
    group.addoption("--testbed-trials", type=_trials, metavar="N", help="trials of each scenario, in place of its own number")
    group.addoption("--testbed-seed", type=int, metavar="S", help="root of all randomness, in place of each scenario's own")
    group.addoption("--testbed-jobs", type=_jobs, metavar="N", default=1, help="processes a scenario runs in, or auto (default: 1)")


def _trials(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"takes a number from 1, not {text!r}")
    return int(text)


def _jobs(text: str) -> int | str:
    if text == "auto":
        return text
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"takes a number from 1, or auto, not {text!r}")
    return int(text)


def pytest_configure(config: pytest.Config) -> None:
    """Find the roots. UsageError for one that isn't there: its tests would be missed by nobody."""
    roots = tuple(Path(os.path.normpath(config.rootpath / root)) for root in config.getini(ROOTS))
    for root in roots:
        if not root.exists():
            raise pytest.UsageError(f"{ROOTS}: there is no {root}")
    config.stash[_roots] = roots


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ScenarioFile | None:
    """A YAML file at or under a root."""
    roots = parent.config.stash[_roots]
    if not roots or file_path.suffix not in (".yaml", ".yml") or not any(file_path.is_relative_to(root) for root in roots):
        return None
    from testbed.pytest_nodes import ScenarioFile

    return ScenarioFile.from_parent(parent, path=file_path)


# ---------------------------------------------------------------- pytest-xdist: each scenario still runs once


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Give a worker of pytest-xdist the folder that it shares with the others."""
    stash = node.config.stash
    if stash[_roots] and _shared not in stash:
        stash[_shared] = Path(tempfile.mkdtemp(prefix="testbed-"))
    if _shared in stash:
        node.workerinput[SHARED] = str(stash[_shared])


def pytest_unconfigure(config: pytest.Config) -> None:
    """Delete that folder."""
    if _shared in config.stash:
        shutil.rmtree(config.stash[_shared], ignore_errors=True)


def shared_folder(config: pytest.Config) -> Path | None:
    """The folder that this worker shares with others on this machine; None where there are no others."""
    given = getattr(config, "workerinput", {}).get(SHARED)
    return Path(given) if given and Path(given).is_dir() else None
