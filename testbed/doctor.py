"""What is missing, shadowed or half built on this machine, and what to do about it."""

from __future__ import annotations

import importlib
import importlib.util
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from testbed import plugins

DISTRIBUTION = "warehouse-radio-testbed"
PACKAGES = ("testbed", "worlds", "estimators", "scenarios")
EXTRAS = {"cluster": ("distributed", "fsspec"), "viz": ("rerun", "mcap"), "mesh": ("trimesh", "collada", "embreex")}


@dataclass(frozen=True)
class Finding:
    """One thing looked at: "ok", "note" (works, with less) or "broken" (something will fail), and how to mend it."""

    level: str
    what: str
    mend: str = ""


def examine() -> list[Finding]:
    """Look at everything; never raises for what it finds."""
    found: list[Finding] = []
    for look in (_python, _distribution, _shadowed, _pybullet, _numba_cache, _extras, _registered):
        found += look()
    return found


def _python() -> list[Finding]:
    return [Finding("ok", f"Python {'.'.join(map(str, sys.version_info[:3]))}")]


def _distribution() -> list[Finding]:
    try:
        return [Finding("ok", f"{DISTRIBUTION} {metadata.version(DISTRIBUTION)}")]
    except metadata.PackageNotFoundError:
        return [Finding("broken", f"{DISTRIBUTION} is not installed: plug-ins can't be found", "pip install . in the project's folder")]


def _shadowed() -> list[Finding]:
    """A folder named `worlds` or `estimators` earlier on the path hides ours; so does PyPI's own `testbed`."""
    here, found = Path(__file__).resolve().parent.parent, []
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        places = list(spec.submodule_search_locations or []) if spec else []
        if not places:
            found.append(Finding("broken", f"package {name!r} is missing", f"pip install --force-reinstall {DISTRIBUTION}"))
        elif Path(places[0]).resolve().parent != here:
            found.append(
                Finding(
                    "broken", f"package {name!r} is taken from {places[0]}, which hides ours", "run from another folder, or rename that one"
                )
            )
    try:
        other = metadata.version("testbed")
    except metadata.PackageNotFoundError:
        return found or [Finding("ok", "packages testbed, worlds, estimators, scenarios are ours")]
    return [*found, Finding("broken", f"the distribution 'testbed' {other} of somebody else is installed as well", "pip uninstall testbed")]


def _pybullet() -> list[Finding]:
    if not _there("pybullet"):
        mend = "Python 3.11: pip install pybullet; 3.12 and later build it from source: pip install 'warehouse-radio-testbed[sim]'"
        return [Finding("note", "pybullet is missing: validate, replay and scenarios without dynamic motion work", mend)]
    try:
        bullet = importlib.import_module("worlds.bullet")
        with_numpy, version = bullet.numpy_enabled(), bullet.version()
    except Exception as error:  # whatever a broken binary does: it is what we came to report
        return [Finding("broken", f"pybullet is installed but can't be loaded: {error}", "pip install --force-reinstall pybullet")]
    if not with_numpy:
        return [
            Finding(
                "note",
                f"pybullet {version} was built without numpy support: camera renders are slow",
                "install numpy first, then rebuild, or use Python 3.11",
            )
        ]
    return [Finding("ok", f"pybullet {version} with numpy support")]


def _there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # blocked or half imported: not to be had either
        return False


def _numba_cache() -> list[Finding]:
    """Compiled kernels are kept beside the code, or in the user's cache folder where that is read-only."""
    places = [Path(__file__).resolve().parent, Path.home()]
    if any(_writable(place) for place in places):
        return [Finding("ok", "compiled kernels can be kept")]
    return [
        Finding(
            "note",
            "compiled kernels can't be kept: every process compiles afresh",
            "set NUMBA_CACHE_DIR to a folder that can be written to",
        )
    ]


def _writable(folder: Path) -> bool:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _extras() -> list[Finding]:
    found = []
    for extra, modules in EXTRAS.items():
        missing = [m for m in modules if not _there(m)]
        if missing:
            found.append(
                Finding("note", f"extra {extra!r} is not installed ({', '.join(missing)})", f"pip install '{DISTRIBUTION}[{extra}]'")
            )
    if shutil.which("chromium") is None and shutil.which("google-chrome") is None:
        found.append(Finding("note", "no Chromium: tests of pages in a browser are skipped", "apt-get install chromium"))
    return found


def _registered() -> list[Finding]:
    """Every plug-in of every group can be loaded."""
    return [finding for group in plugins.GROUPS for name in plugins.names(group) if (finding := _loads(group, name, plugins.load))]


def _loads(group: str, name: str, load: Callable[[str, str], type]) -> Finding | None:
    try:
        load(group, name)
    except Exception as error:
        return Finding("broken", f"{group[:-1]} {name!r} ({plugins.origin(group, name)}) can't be loaded: {error}", "mend or uninstall it")
    return None
