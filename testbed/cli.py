"""The command `testbed`. Results go to stdout, logs and progress to stderr; exit codes are in `Exit`."""

from __future__ import annotations

import json
import os
import sys
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer
from rich.console import Console

from testbed import cli_calibrate, cli_compare, cli_coverage, cli_export, cli_fidelity, cli_replay, cli_speak, console, plugins
from testbed.evaluate import plain
from testbed.scenario import ScenarioError

app = typer.Typer(
    name="testbed",
    help="A testbed for finding things in a warehouse by radio.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


class Exit(IntEnum):
    """What the exit code says."""

    FINE = 0
    EXPECTATION = 1  # a claim of a scenario did not hold
    INPUT = 2  # bad input: a file, a name, an option
    CRASH = 3  # a trial crashed; the others are kept
    INTERRUPTED = 130


Names = Annotated[list[str], typer.Argument(help="Scenario files, or names of scenarios that ship (see `testbed scenarios`).")]
Sets = Annotated[list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Set a value of the scenario; may come several times.")]


def main(arguments: list[str] | None = None) -> None:
    """Run the command; the entry point of the console script and of `python -m testbed`."""
    _keep_stdout_clean()
    try:
        code = app(arguments, standalone_mode=False)
    except (ScenarioError, plugins.UnknownPlugin, plugins.BrokenPlugin) as error:
        code = _complain(str(error))
    except typer.Exit as leaving:
        code = leaving.exit_code
    except typer.Abort:
        code = Exit.INTERRUPTED
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)  # noqa: T201
        code = Exit.INTERRUPTED
    except BrokenPipeError:  # whoever read the results has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        code = Exit.FINE
    except Exception as error:
        code = _known(error)
    sys.exit(int(code or Exit.FINE))


def _known(error: Exception) -> int:
    """Errors of use, from typer and from the store, in their own words; others keep their traceback."""
    from testbed.batch import Interrupted
    from testbed.pool import CannotStart
    from testbed.store import StoreError
    from testbed.until import NotReached

    show = getattr(error, "show", None)
    if show is not None:  # a usage error of the command line
        show()
        return Exit.INPUT
    if isinstance(error, StoreError | CannotStart | NotReached):
        return _complain(str(error))
    if isinstance(error, Interrupted):
        _complain(str(error))
        return Exit.INTERRUPTED
    raise error


def _complain(message: str) -> int:
    print(message, file=sys.stderr)  # noqa: T201
    return Exit.INPUT


def _keep_stdout_clean() -> None:
    """Let whatever native code prints go to stderr: stdout carries results, JSON among them, and nothing else."""
    try:
        if sys.stdout.fileno() != 1:
            return
    except (OSError, ValueError):  # captured, or closed: not ours to move
        return
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = os.fdopen(kept, "w", encoding="utf-8", newline="\n")


def _out() -> Console:
    """For results. Wide enough for a table where it is no terminal."""
    return _console(sys.stdout)


def _console(file: TextIO) -> Console:
    return Console(file=file, width=None if file.isatty() else 180, highlight=False)


def _print_json(document: Any) -> None:
    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")


Trials = Annotated[int | None, typer.Option(help="Trials to run, in place of the scenario's number.")]
Seed = Annotated[int | None, typer.Option(help="Root of all randomness, in place of the scenario's.")]
Only = Annotated[list[str] | None, typer.Option("--estimator", help="Run this estimator only; may come several times.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]


@app.command()
def run(
    scenarios: Names,
    trials: Trials = None,
    seed: Seed = None,
    jobs: Annotated[str, typer.Option(help="Processes: a number, auto for one a core, 0 for this very one (for a debugger).")] = "auto",
    cluster: Annotated[str, typer.Option(metavar="ADDRESS", help="Work on a cluster: tcp://HOST:PORT, or slurm:PROFILE.yaml.")] = "",
    shared: Annotated[str, typer.Option(metavar="URL", help="Where a cluster leaves recordings, if it can't see --out.")] = "",
    until: Annotated[str, typer.Option(metavar="FIGURE", help='Run more trials until it is known: "ukf.position_error_m.mean ± 2%".')] = "",
    max_trials: Annotated[int, typer.Option(help="With --until: at most so many.", min=2)] = 10_000,
    sets: Sets = None,
    estimator: Only = None,
    out: Annotated[Path | None, typer.Option(help="Output folder; runs/NAME where left out, or runs/NAME-2, ...")] = None,
    keep: Annotated[str, typer.Option(help="Recordings to keep: none, all, or some of failed, first:N, worst:N.")] = "first:1,failed",
    resume: Annotated[bool, typer.Option("--resume", help="Go on in --out: what is there stays, what changed is run again.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the run that is in --out.")] = False,
    with_report: Annotated[bool, typer.Option("--report/--no-report", help="Write report.html into the output folder.")] = True,
    as_json: Json = False,
) -> None:
    """Run scenarios: simulate their trials, run every estimator on them, score, judge what the scenario expects, report."""
    from testbed import batch, pool
    from testbed.api import scenario_of
    from testbed.keep import Keep
    from testbed.progress import choose
    from testbed.until import Until

    if resume and out is None:
        raise typer.Exit(_complain("--resume needs --out, the folder of the run to go on with"))
    if jobs != "auto" and not jobs.isdecimal():
        raise typer.Exit(_complain(f"--jobs takes a number from 0, or auto, not {jobs!r}"))
    try:
        Keep.parse(keep)
    except ValueError as error:
        raise typer.Exit(_complain(f"--keep: {error}")) from None
    try:
        enough = Until.parse(until, max_trials) if until else None
    except ValueError as error:
        raise typer.Exit(_complain(f"--until: {error}")) from None
    how: dict[str, Any] = {"jobs": "auto"} if jobs == "auto" else {"jobs": max(1, int(jobs))}
    if jobs != "0" and not cluster:
        how["executors"] = pool.Workers  # a crash in native code then ends a process of theirs, not this one
    how |= {"cluster": cluster, "shared": shared, "until": enough}
    loaded = [scenario_of(n, trials=trials, seed=seed, estimators=estimator or (), sets=sets or ()) for n in scenarios]
    for scenario in loaded:
        _placed(scenario.points()[:1])  # what only the hall can tell, before a folder is made
    results = []
    for scenario in loaded:
        folder = _folder(out, scenario.name, several=len(loaded) > 1)
        progress = choose(sys.stderr)
        found = batch.run(scenario, out=folder, keep=keep, resume=resume, force=force, command=sys.argv, progress=progress, **how)
        results.append(found)
        if not as_json:
            console.run(_out(), found)
        page = _reported(folder) if with_report else None
        if page and not as_json:
            _out().print(f"report in {page}", soft_wrap=True)
    if as_json:
        documents = [result.document() for result in results]
        _print_json(documents[0] if len(documents) == 1 else {"scenarios": documents, "ok": all(d["ok"] for d in documents)})
    raise typer.Exit(_verdict(results))


def _reported(folder: Path) -> Path | None:
    """The report of a run that is finished; one that can't be made is told in a sentence, for the results are there all the same."""
    from testbed.report import write

    try:
        return write(folder)
    except Exception as error:
        again = f"the results are whole; testbed report {folder} tries again and shows where it went wrong"
        _complain(f"the report could not be made ({type(error).__name__}: {error}); {again}")
        return None


def _placed(points: list[Any]) -> list[str]:
    """What each point puts into its hall; on stderr, what became of a world's file.

    ScenarioError for a tag, an antenna or a camera that the hall has no place for.
    """
    from testbed.simulate import Simulator

    found = []
    for point in points:
        with Simulator(point.scenario, rays=False) as simulator:
            found.append(f"{len(simulator.tagged.tags)} tags, {len(simulator.aims.targets)} targets")
            if point is points[0]:
                typer.echo("".join(f"{point.scenario.name}: {note}\n" for note in simulator.notes), err=True, nl=False)
    return found


def _folder(out: Path | None, name: str, several: bool) -> Path:
    """Where a run is written: as told, a folder a scenario where there are several, else the first free runs/NAME."""
    if out is not None:
        return out / name if several else out
    names = [name, *(f"{name}-{i}" for i in range(2, 10_000))]
    return next(folder for n in names if not (folder := Path("runs") / n).exists())


def _verdict(results: list[Any]) -> Exit:
    if any(result.failures for result in results):
        return Exit.CRASH
    return Exit.FINE if all(result.ok for result in results) else Exit.EXPECTATION


@app.command()
def rerun(
    folder: Annotated[Path, typer.Argument(help="Output folder of a run.")],
    trial: Annotated[int, typer.Option(help="Which trial, from 0.")],
    point: Annotated[int, typer.Option(help="Which point of the sweep, from 0.")] = 0,
    into: Annotated[Path | None, typer.Option("--out", help="Keep its recording under this folder.")] = None,
    as_json: Json = False,
) -> None:
    """Make one trial of a run again from its manifest, and show its figures, or the traceback of what crashed."""
    from testbed import batch

    try:
        again = batch.rerun(folder, point, trial, into=into)
    except ValueError as error:  # no such point or trial
        raise typer.Exit(_complain(str(error))) from None
    if again.changed:
        print(f"note: {again.changed}; the figures may differ from the run's own", file=sys.stderr)  # noqa: T201
    for failure in again.failures:
        print(failure.traceback, file=sys.stderr)  # noqa: T201
    figures = {name: [plain(v) if isinstance(v, float) else v for v in column.tolist()] for name, column in again.rows.items()}
    if as_json:
        _print_json({"point": point, "trial": trial, "rows": figures})
    else:
        console.figures(_out(), f"trial {trial}", figures)
    raise typer.Exit(Exit.CRASH if again.failures else Exit.FINE)


@app.command()
def replay(
    folder: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Output folder of a run, or one recording in it; with --site, a reader's log.")
    ],
    estimator: Only = None,
    site: Annotated[Path | None, typer.Option(help="The site of a log: antennas, tags, how the log is written (YAML).")] = None,
    truth: Annotated[Path | None, typer.Option(help="True path, for a log; what comes of it is then scored.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write the tracks into this folder; of a log, runs/NAME where left out.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the run that is in --out (of a log).")] = False,
    as_json: Json = False,
) -> None:
    """Run estimators on recordings that are kept, or on a real reader's log, without simulating. Needs no pybullet."""
    if site is not None:
        return cli_replay.replay_log(folder, site, truth, list(estimator or ()), out, as_json, force)
    from testbed.replay import replay as again

    found = again(folder, estimator or (), out)
    if as_json:
        documents = {s.estimator: s.document() for s in found.summaries}
        _print_json({"scenario": found.scenario.name, "recordings": len({key[:2] for key in found.tracks}), "estimators": documents})
    else:
        console.results(_out(), f"{found.scenario.name}, replayed", found.summaries, {})


@app.command()
def explain(
    source: Annotated[
        str, typer.Argument(metavar="RUN", help="Output folder of a run; or a scenario file, or the name of one that ships.")
    ],
    tag: Annotated[str, typer.Option(help="Id of the tag.")],
    antenna: Annotated[str, typer.Option(help="Id of the antenna.")],
    time: Annotated[float, typer.Option("--time", metavar="S", help="When, s from the start of the trial.")],
    trial: Annotated[int, typer.Option(help="Which trial, from 0.")] = 0,
    point: Annotated[int, typer.Option(help="Which point of the sweep, from 0.")] = 0,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Say why a tag was read at a time of a trial, or why not: the link by path, what is in the way, what the reader was doing."""
    from testbed import explain as why
    from testbed.explain import wording as words

    scenario, changed = why.of_run(source, sets or ())
    try:
        found = why.explain(scenario, tag=tag, antenna=antenna, t=time, point=point, trial=trial)
    except why.NotThere as error:
        raise typer.Exit(_complain(str(error))) from None
    if changed:
        print(f"note: {changed}; the trial may differ from the run's own", file=sys.stderr)  # noqa: T201
    if as_json:
        _print_json({"verdict": words.verdict(found), **found.document()})
    else:
        words.show(_out(), found)


app.command("coverage")(cli_coverage.coverage)
app.command("export")(cli_export.export)
app.command("fidelity")(cli_fidelity.fidelity)
app.command("compare")(cli_compare.compare)
app.command("leaderboard")(cli_compare.leaderboard)
app.command("calibrate")(cli_calibrate.calibrate)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="Output folder of a run.")],
    show: Annotated[str, typer.Option("--open", help="Show it in a browser: yes, no, or auto for yes on a terminal.")] = "auto",
) -> None:
    """Write report.html, one page that holds everything it shows, from the output folder of a run; nothing is simulated again."""
    from testbed.report import write

    if show not in ("yes", "no", "auto"):
        raise typer.Exit(_complain(f"--open takes yes, no or auto, not {show!r}"))
    page = write(folder)
    _out().print(str(page), soft_wrap=True)
    if show == "yes" or (show == "auto" and sys.stdout.isatty()):
        import webbrowser

        webbrowser.open(page.resolve().as_uri())


@app.command()
def render(
    folder: Annotated[Path, typer.Argument(help="Output folder of a run.")],
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")],
    camera: Annotated[list[str] | None, typer.Option("--camera", help="Only this camera of the scenario; may come several times.")] = None,
    animated: Annotated[bool, typer.Option("--animated", help="The whole trial as an animated WebP instead of PNGs.")] = False,
    tracks: Annotated[bool, typer.Option(help="Draw truth and estimates over the picture.")] = True,
) -> None:
    """Draw what the scenario's cameras saw in the recordings of a run: no display is needed, and no simulation."""
    from testbed.report.pictures import render as rendered

    try:
        for path in rendered(folder, out, camera or (), animated, tracks):
            _out().print(str(path), soft_wrap=True)
    except ImportError as error:
        raise typer.Exit(_complain(str(error))) from None


app.command("speak")(cli_speak.speak)


@app.command()
def validate(scenarios: Names, sets: Sets = None) -> None:
    """Check scenario files, the places of tags and antennas included, without running anything. Needs no pybullet."""
    from testbed.scenario import load

    wrong: list[str] = []
    for name in scenarios:
        try:
            scenario = load(name, sets or ())
            placed = _placed(scenario.points())
            _out().print(f"{name}: fine: {len(placed)} point(s) of {scenario.trials} trials; {placed[0]}", soft_wrap=True)
        except ScenarioError as error:
            wrong.append(str(error))
    if wrong:
        raise typer.Exit(_complain("\n".join(wrong)))


@app.command()
def schema() -> None:
    """Print the JSON Schema of scenario files, with all plug-ins that are installed: for an editor's completion and checks."""
    from testbed.scenario.schema import json_schema

    _print_json(json_schema())


@app.command()
def init(
    path: Annotated[Path, typer.Argument(help="The file to write.")] = Path("scenario.yaml"),
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
) -> None:
    """Write a commented scenario to start from, and the schema beside it."""
    from testbed.scenario.schema import json_schema
    from testbed.scenario.starter import starter

    beside = path.parent / "scenario.schema.json"
    if path.exists() and not force:
        raise typer.Exit(_complain(f"{path} is there already: choose another name, or give --force"))
    try:
        path.write_text(starter(path.stem if path.stem.isidentifier() else "my-scenario"), encoding="utf-8")
        beside.write_text(json.dumps(json_schema(), indent=1), encoding="utf-8")
    except OSError as error:
        raise typer.Exit(_complain(f"{path} can't be written: {error.strerror}")) from None
    _out().print(f"wrote {path} and {beside}; now: testbed run {path}", soft_wrap=True)


@app.command()
def scenarios() -> None:
    """List the scenarios that ship."""
    from testbed.scenario import listing

    for name, title, _ in listing():
        _out().print(f"{name:28} {title}", soft_wrap=True)


@app.command("plugins")
def plugins_(group: Annotated[str | None, typer.Argument(help="worlds, actors, sensors, estimators or metrics")] = None) -> None:
    """List the plug-ins, and where each comes from."""
    if group is not None and group not in plugins.GROUPS:
        raise typer.Exit(_complain(f"no group {group!r}{plugins.suggest(group, list(plugins.GROUPS))}"))
    for one in plugins.GROUPS if group is None else (group,):
        _out().print(f"[bold]{one}[/bold]")
        for name in plugins.names(one):
            _out().print(f"  {name:20} {plugins.origin(one, name)}", soft_wrap=True)


@app.command()
def doctor() -> None:
    """Say what is missing, shadowed or half built on this machine, and what to do about it."""
    from testbed.doctor import examine

    found = examine()
    console.findings(_out(), found)
    if any(finding.level == "broken" for finding in found):
        raise typer.Exit(Exit.INPUT)
