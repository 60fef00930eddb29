"""Work for workers must be importable by name in the processes that they spawn, which get this process's path."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "fakes"))
