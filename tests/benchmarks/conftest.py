"""Recordings made for several kinds of tests lie beside the unit tests' fakes."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "fakes"))
