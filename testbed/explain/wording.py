"""An explanation in words: the verdict in a sentence, what would mend it, and the tables behind it. Computes next to nothing."""

from __future__ import annotations

import math
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from testbed.explain.counts import Block
from testbed.explain.explanation import Explanation, Reason, Serving, Visit
from testbed.explain.link import Budget, Obstacle, Passage, Path
from testbed.radio.propagation import POLARISATION_DB

WORTH = 3.0  # dB: what takes less is no cause
SHOWN = 6  # reflections in the table; the others are told in one row
DIFFERENT = 0.1  # dB between the link in full and as the trial has it, from which on it is said


class _Row(NamedTuple):
    """Obstacles of one body and material."""

    body: str
    material: str
    moving: bool
    holds_tag: bool
    boxes: int
    inside_m: float
    loss_db: float


# ---------------------------------------------------------------- in a sentence


def verdict(e: Explanation) -> str:
    """Whether it was read and why, and what to do about it where that is plain."""
    if e.serving is None:
        return _counted(e.block)
    link, serving = e.budget, e.serving
    found = {
        Reason.READ: lambda: _read(link, serving, e.t),
        Reason.NOT_SELECTED: lambda: (
            f"not read: Select lets only {', '.join(serving.select)} through, so the tag is never asked. Put its id under select"
        ),
        Reason.SILENCED: lambda: _silenced(serving),
        Reason.ASLEEP: lambda: f"not read: {_asleep(link)}{_cause(e)}",
        Reason.UNHEARD: lambda: f"not read: {_unheard(link)}{_cause(e)}",
        Reason.NOT_SERVED: lambda: _not_served(e, serving),
        Reason.FADED: lambda: (
            f"not read: it answered at {_times(_visit(serving).lost_s)}, when the link failed for a moment; at {e.t:g} s it would have "
            f"held, with {link.forward_db:.1f} dB to spare"
        ),
        Reason.LATE: lambda: (
            f"not read: when the visit began, at {_visit(serving).start_s:.3f} s, the link was too weak for it to take part; at {e.t:g} s "
            f"it holds, with {link.forward_db:.1f} dB to spare"
        ),
        Reason.NO_SLOT: lambda: _no_slot(_visit(serving)),
    }[Reason(e.reason)]()
    return f"{found}."


def _visit(serving: Serving) -> Visit:
    if serving.now is None:
        raise ValueError("the antenna was not being served: there is no visit to speak of")
    return serving.now


def _read(link: Budget, serving: Serving, t: float) -> str:
    visit = _visit(serving)
    n = len(visit.reads_s)
    times = f"{n} times" if n > 1 else f"at {_times(visit.reads_s)}"
    found = f"read: {times} in the visit from {visit.start_s:.3f} to {visit.end_s:.3f} s"
    if link.forward_db >= 0 and link.reverse_db >= 0:
        return f"{found}; the tag gets {link.tag_dbm:.1f} dBm, {link.forward_db:.1f} dB more than wakes it"
    return f"{found}, though not at {t:g} s itself: then {_asleep(link) if link.forward_db < 0 else _unheard(link)}"


def _asleep(link: Budget) -> str:
    return f"the tag gets {link.tag_dbm:.1f} dBm, {-link.forward_db:.1f} dB less than wakes it"


def _unheard(link: Budget) -> str:
    return f"the tag wakes, but the reader gets {link.reader_dbm:.1f} dBm, {-link.reverse_db:.1f} dB less than it understands"


def _silenced(serving: Serving) -> str:
    again = "not again in this trial" if serving.next_asked_s is None else f"again from {serving.next_asked_s:.3f} s"
    read = "" if serving.last_read_s is None else f"{serving.last_read_by} read it at {serving.last_read_s:.3f} s, and "
    return (
        f"not read: {read}the flag of session {serving.session} keeps it from being asked ({again}). "
        "With dual_target, or in session 0, it would go on answering"
    )


def _not_served(e: Explanation, serving: Serving) -> str:
    busy = f"was serving {serving.elsewhere}" if serving.elsewhere else "was changing from one antenna to the next"
    visits = [(name, v) for name, v in (("before", serving.before), ("after", serving.after)) if v is not None]
    link = f"The link itself holds, with {e.budget.forward_db:.1f} dB to spare"
    if visits and all(v.reads_s for _, v in visits):
        told = " and ".join(f"{name} ({v.start_s:.3f} to {v.end_s:.3f} s)" for name, v in visits)
        return f"read in {e.antenna}'s visit {told}; at {e.t:g} s itself the reader {busy}. {link}"
    told = " and ".join(f"{_outcome(v)} in its visit {name}, {v.start_s:.3f} to {v.end_s:.3f} s" for name, v in visits)
    less = f". It serves {serving.antennas} antennas in turn: fewer, or shorter visits, come by more often" if serving.antennas > 1 else ""
    return f"not read at {e.t:g} s itself: the reader {busy}, not {e.antenna}; {told or 'it never serves it in this trial'}. {link}{less}"


def _outcome(visit: Visit) -> str:
    if visit.reads_s:
        return "read"
    if not visit.asked:
        return "not asked"
    return f"not read ({'its answer was lost' if visit.lost_s else 'without a slot of its own' if visit.able else 'too weak to take part'})"


def _no_slot(visit: Visit) -> str:
    others = f"{visit.others_able} other tags could answer, {visit.others_read} were read and {visit.collisions} slots were collisions"
    return (
        f"not read: it was asked and could answer, but had no slot to itself before the visit ended; {others} from {visit.start_s:.3f} to "
        f"{visit.end_s:.3f} s. Longer visits (longest_visit_s), or fewer tags at once, leave room"
    )


def _counted(block: Block | None) -> str:
    if block is None:
        return "not counted: the trial ends before the slot does."
    model = f"at {block.distance_m:.2f} m and {block.angle_deg:.0f}° the model answers a query with {block.probability:.2f}"
    if block.count:
        return f"read: {block.count} of {block.queries} queries in the block that ended at {block.end_s:.3f} s; {model}."
    if not block.dead:
        return f"not read: none of {block.queries} queries in the block that ended at {block.end_s:.3f} s was answered; {model}."
    of = f"geometry closes {block.geometry:.0%}, and {block.residual:.0%} is left over"
    zone = f"not read: a dead zone held (probability {block.dead_probability:.2f}: {of}) in the block that ended at {block.end_s:.3f} s"
    return f"{zone}; without it {block.alive} of {block.queries} queries were answered."


# ---------------------------------------------------------------- what takes most


def _cause(e: Explanation) -> str:
    """What takes most of a link that fails, and what would mend it."""
    link, gains = e.budget, e.budget.direct.gains
    short = max(-link.forward_db, -link.reverse_db / 2)
    hangs = -gains.orientation_db + max(0.0, -gains.polarisation_db - POLARISATION_DB)
    causes = [
        (link.direct.passage.loss_db, *_in_the_way(link.direct.passage)),
        (e.gain_dbi - gains.antenna_db, f"the tag is {gains.off_boresight_deg:.0f}° off the antenna's boresight, which takes {{:.0f}} dB",
         "Turn the antenna"),
        (hangs, "the tag hangs badly for this antenna, which takes {:.0f} dB", "Turn the tag"),
        (link.unfaded_db - link.total_db, "the paths cancel each other here, which takes {:.0f} dB",
         "Some centimetres, another antenna or another carrier change that"),
    ]  # fmt: skip
    takes, says, mend = max(causes, key=lambda cause: cause[0])
    besides = _besides(e)
    if takes >= WORTH:
        return f"; {says.format(takes)}{besides}" + (f". {mend}" if takes >= short else "")
    if short <= e.headroom_db:
        return f"; nothing is in the way{besides}. {short:.1f} dB more power would do, and the region allows {e.headroom_db:.1f}"
    reach = link.direct.length_m * 10 ** (-short / 20)
    return f"; nothing is in the way, it is {link.direct.length_m:.1f} m off{besides}. An antenna within about {reach:.1f} m would do"


def _in_the_way(passage: Passage) -> tuple[str, str]:
    by = _by_body(passage.obstacles)
    if not by:
        names = f" ({', '.join(passage.beside[:2])})" if passage.beside else ""
        return f"what stands close to the line{names} takes {{:.0f}} dB", "Give the line more room"
    most = max(by, key=lambda row: row.loss_db)
    if passage.way == "round":
        names = list(dict.fromkeys(row.body for row in sorted(by, key=lambda row: -row.loss_db)))[:3]
        says = f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} in the way, and the way round takes {{:.0f}} dB"
    else:
        rest = "" if len(by) == 1 else f" of the {passage.loss_db:.0f} dB that the way takes"
        says = f"{most.body} ({most.material}) takes {most.loss_db:.0f} dB{rest}"
    if most.holds_tag:
        return says, f"The tag is on {most.body}: put it on a side that the antenna sees"
    return says, f"It is free when {most.body} has passed" if most.moving else f"Move {most.body}, or the antenna to where it sees the tag"


def _by_body(obstacles: tuple[Obstacle, ...]) -> list[_Row]:
    """The obstacles of one body and material together, in order of the path."""
    found: dict[tuple[str, str], list[Obstacle]] = {}
    for o in obstacles:
        found.setdefault((o.body, o.material), []).append(o)
    return [
        _Row(*key, own[0].moving, any(o.holds_tag for o in own), len(own), sum(o.inside_m for o in own), sum(o.loss_db for o in own))
        for key, own in found.items()
    ]


def _besides(e: Explanation) -> str:
    if e.serving is None or e.serving.now is not None:
        return ""
    instead = f", but {e.serving.elsewhere}" if e.serving.elsewhere else ""
    return f" (and the reader was not serving {e.antenna} at that moment{instead})"


# ---------------------------------------------------------------- in tables


def show(console: Console, e: Explanation) -> None:
    """The verdict, the link by path, what stands on the paths, power at both ends, and what the reader was doing."""
    link, out = e.budget, lambda text: console.print(escape(text), soft_wrap=True)
    console.print(f"[bold]{escape(verdict(e))}[/bold]", soft_wrap=True)
    where = f", point {e.point}" if e.point else ""
    out(f"{e.scenario}{where}, trial {e.trial}: tag {e.tag}, antenna {e.antenna} of {e.sensor}, {e.t:g} s, {link.carrier_hz / 1e6:.2f} MHz")
    if e.serving is None:
        _show_block(console, e.block)
        return
    console.print(_paths(link))
    if any(path.passage.obstacles for path in _shown(link)):
        console.print(_obstacles(link))
    out(_line(link.direct.passage))
    out(
        f"forward: the tag gets {link.tag_dbm:.1f} dBm of {link.sent_dbm:g} sent, needs {link.tag_needs_dbm:.1f}: {link.forward_db:+.1f} dB"
    )
    out(f"reverse: the reader gets {link.reader_dbm:.1f} dBm, needs {link.reader_needs_dbm:.1f}: {link.reverse_db:+.1f} dB")
    if abs(link.run_db - link.total_db) >= DIFFERENT:
        out(f"the run itself goes by {link.run_db:.1f} dB: it leaves out paths that are too weak to matter")
    for text in _reader(e.serving):
        out(text)


def _paths(link: Budget) -> Table:
    table = Table(title="paths, one way", title_justify="left")
    table.add_column("by")
    for name in (
        "length m",
        "free space dB",
        "antenna dBi",
        "at °",
        "tag dBi",
        "polarisation dB",
        "reflection dB",
        "obstacles dB",
        "level dB",
    ):
        table.add_column(name, justify="right")
    shown = _shown(link)
    for path in shown:
        table.add_row(*_row(path, link))
    rest = link.reflections[len(shown) - 1 :]
    if rest:
        table.add_row(f"{len(rest)} weaker", *[""] * 8, _db(_level(sum(path.term for path in rest))))
    if not math.isinf(link.k_db) or link.diffuse:
        table.add_row(f"diffuse, K {_db(link.k_db)} dB", *[""] * 8, _db(link.diffuse_db))
    table.add_section()
    table.add_row("all", *[""] * 8, _db(link.total_db))
    if link.diffuse:
        table.caption = f"the diffuse part changes the direct path by {link.diffuse_adds_db:+.1f} dB here"
        table.caption_justify = "left"
    return table


def _shown(link: Budget) -> list[Path]:
    return [link.direct, *link.reflections[:SHOWN]]


def _row(path: Path, link: Budget) -> list[str]:
    gains = path.gains
    loss = path.passage.loss_db - path.share_db
    return [
        "direct" if not path.by else f"{escape(path.by)}, {path.incidence_deg:.0f}°",
        f"{path.length_m:.2f}",
        _db(-path.spread_db),
        _db(gains.antenna_db),
        f"{gains.off_boresight_deg:.0f}",
        _db(gains.tag_db + gains.orientation_db),
        _db(gains.polarisation_db),
        _db(path.reflection_db) if path.by else "",
        _db(-path.passage.loss_db) if path.passage.loss_db else "0.0",
        _db(path.level_db) if path.by or math.isinf(loss) else _db(link.unfaded_db),
    ]


def _obstacles(link: Budget) -> Table:
    table = Table(title="in the way", title_justify="left")
    for name in ("path", "body", "material"):
        table.add_column(name)
    for name in ("boxes", "inside m", "dB"):
        table.add_column(name, justify="right")
    for path in _shown(link):
        for i, row in enumerate(_by_body(path.passage.obstacles)):
            name = "" if i else path.by or "direct"
            table.add_row(escape(name), escape(row.body), row.material, str(row.boxes), f"{row.inside_m:.2f}", f"{row.loss_db:.1f}")
    return table


def _line(passage: Passage) -> str:
    """The direct path's way past what is there."""
    clear = f"line of sight: {passage.clear:.0%} of the zone is clear"
    if passage.way == "clear":
        return clear
    beside = f"{passage.shade_db:.1f} dB by what stands close to it ({', '.join(passage.beside[:3])})"
    through = [f"{passage.through_db:.1f} dB through"] * bool(passage.obstacles) + [beside] * (passage.shade_db > 0)
    round_ = "no way round" if math.isinf(passage.round_db) else f"{passage.round_db:.1f} dB round"
    taken = f"the wave goes round, {passage.detour_m * 100:.0f} cm farther" if passage.way == "round" else "the wave goes through"
    return f"{clear}; {' + '.join(through)}, {round_}: {taken}"


def _reader(serving: Serving) -> list[str]:
    targets, select = (
        "both targets" if serving.dual_target else "one target",
        f", Select {', '.join(serving.select)}" if serving.select else "",
    )
    told = [f"reader: session {serving.session}, {targets}, serves {serving.antennas} antenna(s) in turn{select}"]
    if serving.now is None:
        told.append(f"at that moment it served {serving.elsewhere or 'no antenna'}")
    for name, visit in (("visit before", serving.before), ("visit now", serving.now), ("visit after", serving.after)):
        if visit is not None:
            told.append(f"{name}, {visit.start_s:.3f} to {visit.end_s:.3f} s: {_said(visit)}")
    if serving.last_read_s is not None:
        told.append(f"before that it read the tag last at {serving.last_read_s:.3f} s, by {serving.last_read_by}")
    return told


def _said(visit: Visit) -> str:
    own = f"read {len(visit.reads_s)} times" if len(visit.reads_s) > 1 else f"read at {_times(visit.reads_s)}"
    if not visit.reads_s:
        own = "asked, not read" if visit.asked else "not asked"
    lost = f", {len(visit.lost_s)} answers lost" if visit.lost_s else ""
    able = "" if visit.able else ", too weak to take part"
    others = f"other tags: {visit.others_able} could answer, {visit.others_read} read ({visit.others_reads} reads)"
    return f"{own}{lost}{able}; {others}; {visit.collisions} collisions"


def _show_block(console: Console, block: Block | None) -> None:
    if block is None:
        return
    table = Table(title="published detection model", title_justify="left", show_header=False)
    for name, value in (
        ("slot, end of the block", f"{block.start_s:.3f} s, {block.end_s:.3f} s"),
        ("distance, angle off boresight", f"{block.distance_m:.2f} m, {block.angle_deg:.1f}°"),
        ("mean probability of an answer", f"{block.probability:.3f}"),
        ("answers, dead zones aside", f"{block.alive} of {block.queries}"),
        ("closed by geometry", f"{block.geometry:.3f}"),
        ("residual dead zone", f"{block.residual:.3f}"),
        ("dead", f"{'yes' if block.dead else 'no'} (probability {block.dead_probability:.3f})"),
        ("count", str(block.count)),
    ):
        table.add_row(name, value)
    console.print(table)


def _times(times: tuple[float, ...]) -> str:
    return ", ".join(f"{t:.3f}" for t in times[:3]) + (" s" if len(times) <= 3 else f" s and {len(times) - 3} times more")


def _db(value: float) -> str:
    return "–" if math.isinf(value) or math.isnan(value) else f"{value:.1f}"


def _level(term: complex) -> float:
    return 20 * math.log10(abs(term)) if term else -math.inf
