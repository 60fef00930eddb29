"""Who may import whom. Read from the sources, and seen in a fresh process for what is reached through others."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("testbed", "worlds", "estimators", "scenarios")
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))

SEEN_BY_ESTIMATORS = {  # geometry: the boxes and roads that a Site is made of, plain data as surveyed; scenes and truth lie elsewhere
    f"testbed.{m}"
    for m in ("types", "columns", "protocols", "quantity", "rng", "frames", "units", "lift", "roads", "guidance", "geometry", "gates")
}
LIBRARIES = {"numpy", "scipy", "filterpy", "numba", "pydantic"}
LEAVES = {  # what each of the lowest modules may stand on, numpy and the standard library aside
    "testbed/columns.py": set(),
    "testbed/units.py": {"testbed.columns"},
    "testbed/frames.py": {"testbed.columns"},
    "testbed/geometry.py": {"testbed.columns"},
    "testbed/guidance.py": {"testbed.columns"},
    "testbed/gates.py": {"testbed.columns", "testbed.types"},  # which antennas hang together, as a site has them: no truth in it
    "testbed/roads.py": {"testbed.columns", "testbed.geometry"},
    "testbed/mixing.py": {"numba"},
    "testbed/rng.py": {"testbed.columns", "testbed.mixing", "scipy.special"},
    "testbed/types.py": {"testbed.columns", "testbed.geometry", "testbed.rng"},
}
OWN = {name: {p.stem for p in (ROOT / name).iterdir()} for name in PACKAGES}


def imports_of(source, package=""):
    """Full names of all modules that a source imports, wherever in the file, and of dynamic imports as "importlib"."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(filter(None, [package if node.level else "", node.module]))
            inner = {alias.name for alias in node.names if alias.name in OWN.get(base, ())}
            found |= {f"{base}.{name}" for name in inner} if base in OWN and inner else set()
            if base not in OWN or len(inner) < len(node.names):
                found.add(base)
        elif isinstance(node, ast.Name) and node.id in ("__import__", "exec", "eval"):
            found.add("importlib")
    return found


def imports_in(path):
    return imports_of(path.read_text(encoding="utf-8"), ".".join(path.relative_to(ROOT).parent.parts))


def forbidden_to_estimators(module):
    top = module.partition(".")[0]
    if top in ("estimators", *LIBRARIES):
        return False
    if top in ("importlib", "imp", "runpy", "pkgutil"):
        return True
    return module not in SEEN_BY_ESTIMATORS and top not in sys.stdlib_module_names


def relative(path):
    return path.relative_to(ROOT).as_posix()


def inside(package):
    return [p for p in FILES if relative(p).startswith(f"{package}/")]


@pytest.mark.parametrize("path", inside("estimators"), ids=relative)
def test_an_estimator_imports_the_data_it_gets_and_nothing_that_knows_the_truth(path):
    assert [m for m in imports_in(path) if forbidden_to_estimators(m)] == []


@pytest.mark.parametrize(
    "line",
    [
        "import testbed.recording",
        "from testbed import simulate",
        "from testbed.radio import antenna",
        "def f():\n    from testbed.scene import Truth",
        "from testbed.recording import Trial",
        "import worlds.bullet",
        "from worlds import raycast",
        "import pybullet",
        "import importlib",
        "from importlib import import_module",
        "__import__('worlds')",
        "import pandas",
        "import testbed",
        "if TYPE_CHECKING:\n    from testbed.sensors.rfid import Rfid",
    ],
)
def test_the_rule_for_estimators_finds_a_breach(line):
    assert any(forbidden_to_estimators(m) for m in imports_of(line))


def test_the_rule_for_estimators_lets_pass_what_it_should():
    lines = "import math\nimport numpy as np\nfrom testbed import frames\nfrom testbed.types import Array\nfrom estimators import kalman"
    assert not any(forbidden_to_estimators(m) for m in imports_of(lines))


@pytest.mark.parametrize("path", inside("testbed"), ids=relative)
def test_the_framework_names_no_world_and_no_estimator(path):
    assert [m for m in imports_in(path) if m.partition(".")[0] in ("worlds", "estimators")] == []


def test_only_one_module_imports_pybullet():
    users = {
        relative(p) for p in FILES if any(m.partition(".")[0] in ("pybullet", "pybullet_utils", "pybullet_data") for m in imports_in(p))
    }
    assert users <= {"worlds/bullet.py"}


@pytest.mark.parametrize("name", LEAVES)
def test_the_lowest_modules_stand_on_numpy_alone(name):
    above = {m for m in imports_in(ROOT / name) if m.partition(".")[0] not in {*sys.stdlib_module_names, "numpy"}}
    assert above <= LEAVES[name]


@pytest.mark.parametrize("name", ["estimate", "events", "feeds", "lift"])
def test_the_driver_has_no_truth_in_it(name):
    source = (ROOT / "testbed" / f"{name}.py").read_text(encoding="utf-8")
    named = {n.id for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Name)}
    assert not named & {"Trial", "Truth", "Surroundings"}
    assert not {
        m for m in imports_of(source) if m in ("testbed.scene", "testbed.simulate") or m.startswith(("testbed.radio", "testbed.sensors"))
    }


@pytest.mark.parametrize("path", [*inside("testbed/sensors"), *inside("testbed/radio"), ROOT / "testbed/simulate.py"], ids=relative)
def test_what_makes_data_knows_nothing_of_estimating(path):
    known = {"testbed.estimate", "testbed.events", "testbed.feeds", "testbed.lift", "testbed.evaluate"}
    assert not {m for m in imports_in(path) if m in known or m.startswith("testbed.metrics")}


REACHED = """
import importlib, json, pathlib, sys
for path in sorted(pathlib.Path(sys.argv[1]).rglob("*.py")):
    importlib.import_module("estimators." + path.stem if path.stem != "__init__" else "estimators")
print(json.dumps(sorted(m for m in sys.modules if m.partition(".")[0] in ("testbed", "worlds", "pybullet"))))
"""


def test_no_estimator_reaches_channel_world_or_truth_through_what_it_imports():
    done = subprocess.run([sys.executable, "-c", REACHED, str(ROOT / "estimators")], capture_output=True, text=True, check=True, cwd=ROOT)
    reached = set(json.loads(done.stdout))
    assert reached <= SEEN_BY_ESTIMATORS | {"testbed", "testbed.view"}  # cameras as plain data
