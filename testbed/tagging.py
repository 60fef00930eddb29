"""From what a scenario says of tags and targets to where they are: bodies and mounts by pattern, spread over bays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.plugins import suggest
from testbed.protocols import Tagged
from testbed.radio.materials import MATERIALS
from testbed.radio.tags import TagModel, tag_model
from testbed.scene import WORLD, Scene
from testbed.sensors.placement import bodies_matching, in_truth, inside_of, rolled
from testbed.solid import holders
from testbed.types import Tags, Targets

if TYPE_CHECKING:
    from testbed.scenario import Scenario, TagRule
    from testbed.scenario.problems import Loc

MOST_TAGS = 100_000


@dataclass(frozen=True)
class _Tag:
    id: str
    body: int  # in the scene, WORLD for none
    pose: Array
    model: TagModel
    loc: Loc  # of its rule


def place_tags(scenario: Scenario, scene: Scene) -> tuple[Tagged, tuple[str, ...]]:
    """All tags of a scenario, and for each the name of the body that it is on ("" for none).

    Raises ScenarioError, naming the place in the file, for a rule that can't be fulfilled or an id that comes twice.
    """
    found: list[_Tag] = []
    owners: dict[str, tuple] = {}
    for loc, rule, body in _rules(scenario):
        try:
            new = _placed(rule, loc, scene, body, len(found))
        except ValueError as error:
            raise scenario.problem(loc, str(error)) from None
        for tag in new:
            if tag.id in owners:
                raise scenario.problem(loc, f"a tag with the id {tag.id!r} is there already: two tags with one EPC can't be told apart")
            owners[tag.id] = loc
        found += new
        if len(found) > MOST_TAGS:
            raise scenario.problem(loc, f"that makes {len(found)} tags; {MOST_TAGS} are the limit")
    ends = [in_truth(scene, tag.body, tag.pose) for tag in found]
    tags = Tags(
        id=np.array([tag.id for tag in found], dtype=np.str_),
        gain=np.array([tag.model.gain_dbi for tag in found]),
        sensitivity=np.array([tag.model.sensitivity_dbm for tag in found]),
        pattern=np.array([tag.model.pattern for tag in found], dtype=np.str_),
    )
    body = np.array([body for body, _ in ends], dtype=np.int64)
    poses = np.array([pose for _, pose in ends], dtype=np.float64).reshape(-1, 7)
    _not_in_metal(scenario, scene, found, body, poses[:, :3])
    return Tagged(tags, body, poses), tuple("" if tag.body == WORLD else scene.bodies[tag.body].name for tag in found)


def _not_in_metal(scenario: Scenario, scene: Scene, tags: list[_Tag], body: Array, position: Array) -> None:
    """ScenarioError for the first tag that metal shuts in: nothing ever reads it. One inside a carton or a person's pocket may be read."""
    metal = np.array([name in MATERIALS and MATERIALS[name].metal for name in scene.materials], dtype=bool)
    solid = scene
    if len(scene.boxes) + len(scene.meshes):
        boxes, meshes = scene.boxes, scene.meshes
        solid = replace(scene, boxes=boxes.take(metal[boxes.material]), meshes=meshes.take(metal[meshes.material]))
    boxes = holders(solid, body, position)
    for k in np.flatnonzero(boxes >= 0):
        owner, material = inside_of(solid, int(boxes[k]))
        raise scenario.problem(
            tags[k].loc, f"the tag {tags[k].id!r} is inside {owner} ({material}): put it outside, on the surface or off it"
        )


def _rules(scenario: Scenario) -> list[tuple[tuple, TagRule, str | None]]:
    """(place in the file, rule, the actor that the rule is written at) for all tag rules, actors' own first."""
    found: list[tuple[tuple, TagRule, str | None]] = [(rule.loc, rule, actor.id) for actor in scenario.actors for rule in actor.tags]
    return found + [(rule.loc, rule, None) for rule in scenario.tags]


def _placed(rule: TagRule, loc: Loc, scene: Scene, actor: str | None, already: int) -> list[_Tag]:
    pattern, model = rule.on or actor, tag_model(rule.model)
    if rule.position_m is not None:
        body = WORLD
        if pattern is not None:
            matching = bodies_matching(scene, pattern)
            if len(matching) > 1:
                raise ValueError(f"on: {pattern!r} fits {len(matching)} bodies, and position_m places one tag on one")
            body = matching[0]
        pose = np.concatenate([rule.position_m, frames.from_euler(*np.deg2rad([rule.yaw_deg, -rule.tilt_deg, rule.roll_deg]))])
        return [_Tag(rule.id or f"{rule.prefix or pattern or 'tag'}-{already + 1}", body, pose, model, loc)]
    if pattern is None:
        raise ValueError("on: a tag on a mount needs the body (or a pattern over bodies) that has the mount")
    spots = _spots(rule, scene, pattern)
    if rule.id is not None and len(spots) > 1:
        raise ValueError(f"id: the rule makes {len(spots)} tags, which can't all be {rule.id!r}: give a prefix instead")
    ids = (
        [rule.id]
        if rule.id is not None
        else [f"{rule.prefix}-{i + 1}" if rule.prefix else str(scene.mounts.name[s]) for i, s in enumerate(spots)]
    )
    mounts = scene.mounts
    return [
        _Tag(id, int(mounts.body[s]), np.concatenate([mounts.position[s], rolled(mounts.quaternion[s], rule.roll_deg)]), model, loc)
        for id, s in zip(ids, spots, strict=True)
    ]


def _spots(rule: TagRule, scene: Scene, pattern: str) -> list[int]:
    """Indices of the mounts that a rule takes: those that fit `mount`, or `per_group` of each group, evenly spread."""
    mounts, chosen = scene.mounts, []
    for body in bodies_matching(scene, pattern):
        prefix = scene.bodies[body].name + "."
        here = np.flatnonzero((mounts.body == body) & (mounts.use == "tag"))
        if rule.mount is not None:
            here = [i for i in here if fnmatchcase(str(mounts.name[i]).removeprefix(prefix), rule.mount)]
        if rule.per_group is None:
            chosen += [int(i) for i in here]
            continue
        for group in dict.fromkeys(str(mounts.group[i]) for i in here):
            members = [int(i) for i in here if mounts.group[i] == group]
            if rule.per_group > len(members):
                raise ValueError(f"per_group: {group} has room for {len(members)} tags, {rule.per_group} are wanted")
            chosen += [members[int(k)] for k in (np.arange(rule.per_group) + 0.5) * len(members) / rule.per_group]
    if not chosen:
        names = sorted(
            {
                str(n).removeprefix(scene.bodies[b].name + ".")
                for n, b, u in zip(mounts.name, mounts.body, mounts.use, strict=True)
                if u == "tag"
            }
        )
        raise ValueError(f"mount: nothing on {pattern!r} fits {rule.mount or '*'!r}{suggest(rule.mount or '', names[:40])}")
    return chosen


@dataclass(frozen=True)
class Aims:
    """The targets of a scenario: names and bodies, the tags of each, and where each truly is (see `Trial`)."""

    targets: Targets
    tags: tuple[Array, ...]
    body: Array
    pose: Array


def choose_targets(scenario: Scenario, scene: Scene, tagged: Tagged, on: Sequence[str]) -> Aims:
    """What is to be located: tags and actors by pattern; without patterns, every tag on an actor that moves.

    A body is where its origin is. Raises ScenarioError for a pattern that fits nothing, or where nothing is left to locate.
    """
    ids, moving = [str(i) for i in tagged.tags.id], scene.moving_names
    chosen: list[tuple[str, int | None]] = []  # (name, tag or None for a body)
    if not scenario.targets:
        chosen = [(id, k) for k, (id, body) in enumerate(zip(ids, on, strict=True)) if body in moving]
        if not chosen:
            chosen = [(id, k) for k, id in enumerate(ids)]
    for i, pattern in enumerate(scenario.targets):
        fitting: list[tuple[str, int | None]] = [(id, k) for k, id in enumerate(ids) if fnmatchcase(id, pattern)]
        fitting += [(name, None) for name in moving if fnmatchcase(name, pattern)]
        if not fitting:
            raise scenario.problem(
                ("targets", i), f"neither a tag nor a moving actor is named {pattern!r}{suggest(pattern, [*moving, *ids[:1000]])}"
            )
        chosen += [one for one in fitting if one not in chosen]
    bodies = [moving.index(name) if tag is None else int(tagged.body[tag]) for name, tag in chosen]
    return Aims(
        targets=Targets(
            name=np.array([n for n, _ in chosen], dtype=np.str_),
            body=np.array([moving[b] if b != WORLD else "" for b in bodies], dtype=np.str_),
        ),
        tags=tuple(
            np.array([k for k, body in enumerate(on) if body == name] if tag is None else [tag], dtype=np.int32) for name, tag in chosen
        ),
        body=np.array(bodies, dtype=np.int64),
        pose=np.array([frames.IDENTITY if tag is None else tagged.pose[tag] for _, tag in chosen]).reshape(-1, 7),
    )
