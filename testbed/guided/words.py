"""The instructions of a guided walk as the person read and heard them: text, and a sound file where espeak-ng is installed."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.guidance import in_words
from testbed.guided.record import Walk

SPEAKER = "espeak-ng"
LIMIT_S = 60  # for one instruction to be spoken


@dataclass(frozen=True)
class Instruction:
    """What a person was told at time `t` s, and, where they did something else, what they said that they did."""

    t: float
    text: str
    answer: str = ""


def instructions(walk: Walk) -> list[Instruction]:
    """Every instruction of a walk, in order. One that stands for a turn and a step is one instruction."""
    found: list[Instruction] = []
    before = ""
    for i in range(1, len(walk)):
        kind, asked = str(walk.kind[i]), float(walk.turn_asked[i])
        if kind == "step" and before == "turn" and walk.step_asked[i] == walk.step_asked[i - 1]:
            before = kind
            continue
        turned = float(walk.informed[i])
        differs = kind == "turn" and abs(turned - np.nan_to_num(asked)) > 1e-9
        answer = f"the person: {in_words(turned, 0.0)}" if differs else ""
        found.append(Instruction(float(walk.began[i]), in_words(asked, float(walk.step_asked[i]), str(walk.said[i])), answer))
        before = kind
    if walk.found[-1]:
        found.append(Instruction(float(walk.t[-1]), "You are there."))
    return found


def listing(walk: Walk) -> str:
    """The instructions as text, a line each with its time."""
    return "".join(f"{one.t:7.1f} s  {one.text}{f'  ({one.answer})' if one.answer else ''}\n" for one in instructions(walk) if one.text)


def speak(text: str, path: Path) -> bool:
    """Say `text` into the WAV file `path`; False where espeak-ng is not installed. RuntimeError, with its words, where it refuses."""
    program = shutil.which(SPEAKER)
    if program is None:
        return False
    done = subprocess.run([program, "-w", str(path), "--", text.replace("°", " degrees")], capture_output=True, text=True, timeout=LIMIT_S)
    if done.returncode:
        raise RuntimeError(f"{SPEAKER} could not say {text!r}: {done.stderr.strip() or 'no reason given'}")
    return True


def write(walk: Walk, folder: Path, sound: bool) -> tuple[Path, int]:
    """Write `instructions.txt` into `folder`, and with `sound` a WAV file for each; its path, and how many sound files there are."""
    folder.mkdir(parents=True, exist_ok=True)
    path, spoken = folder / "instructions.txt", 0
    path.write_text(listing(walk), encoding="utf-8")
    for number, one in enumerate(o for o in instructions(walk) if o.text):
        if not sound or not speak(one.text, folder / f"instruction-{number:03d}.wav"):
            break
        spoken += 1
    return path, spoken
