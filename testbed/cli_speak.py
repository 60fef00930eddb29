"""The command `testbed speak`: what a guided person was told, as text and as sound."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def speak(
    folder: Annotated[Path, typer.Argument(help="Output folder of a run with a guided person.")],
    out: Annotated[Path, typer.Option(help="Folder for the instructions.")],
    sound: Annotated[bool, typer.Option("--sound/--text", help="Sound files as well, where espeak-ng is installed.")] = True,
) -> None:
    """Write down what a guided person was told in the recordings of a run, and say it into sound files."""
    from testbed import cli

    for line in spoken(folder, out, sound):
        cli._out().print(line, soft_wrap=True)


def spoken(folder: Path, out: Path, sound: bool = True) -> list[str]:
    """Instructions of every guide in the recordings of a run, a folder each under `out`; a line about each.

    StoreError for a folder without a guided person's recordings.
    """
    from testbed import archive
    from testbed.guided import words

    found: list[str] = []
    for place in sorted(Path(folder).glob("recordings/point-*/trial-*")):
        trials = {next(iter(archive.load_tracks(place)), "guide"): archive.load_trial(place)}
        trials |= {id: trial for id, (trial, _) in archive.load_guides(place).items()}
        for id, trial in trials.items():
            if trial.walk is None:
                continue
            path, count = words.write(trial.walk, out / place.parent.name / place.name / id, sound)
            said = f"{count} sound files" if count else f"no sound: {words.SPEAKER} is not installed" if sound else "text only"
            found.append(f"{path} ({said})")
    if not found:
        raise archive.StoreError(f"{folder} holds no recording of a guided person: run a guided scenario with --keep first:1")
    return found
