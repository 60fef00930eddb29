"""SDFormat: what a Gazebo world says of collision shapes, its nested models and includes put where they belong.

Read are <world>, <model>, <include>, <link>, <collision>, <pose> and the shapes box, cylinder, sphere and mesh. Left out, and noted: what
moves (joints, and where <state> says that things have got to), what is only seen (visuals, lights), planes, height maps.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes
from worlds.importers.files import WorldFileError, beneath, child, children, local, numbers, read, said, text, xml
from worlds.importers.mesh_files import load_mesh, within_reach
from worlds.importers.solids import Solids, cylinder, solids, sphere

MAX_NESTING = 16  # models in models
MAX_MODELS = 20_000  # with all that they include: one that includes another twice, and so on, would be without end
MAX_SHAPES = 50_000
SCHEME = "model://"


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision shape: its pieces in its own frame, and where that stands in its body's, (7,)."""

    solids: Solids
    pose: Array


@dataclass(frozen=True, eq=False)
class Model:
    """A model that stands in the world by itself: its name, the model that it is ("" for one of its own), its pose (7,), its shapes."""

    name: str
    kind: str
    pose: Array
    shapes: tuple[Shape, ...]


@dataclass
class SdfWorld:
    """The models of a world file. `place` is the file, `models` are folders that hold the models which it includes.

    WorldFileError, with the file and the place in it, for what can't be read; `notes` says in sentences what was left out.
    """

    place: Path
    models: Sequence[Path]
    left_out: Counter[str] = field(default_factory=Counter)
    _documents: dict[Path, Element] = field(default_factory=dict)
    _meshes: dict[tuple[Path, tuple[float, ...]], Solids] = field(default_factory=dict)
    _read: int = 0
    _shapes: int = 0

    @cached_property
    def bodies(self) -> list[Model]:
        """All models at the top of the world, in the order of the file."""
        root = self._document(self.place)
        world = child(root, "world")
        found = []
        for element in root if world is None else world:
            if local(element) in ("model", "include"):
                found.append(self._body(element))
            elif local(element) in ("population", "actor", "state", "road", "heightmap"):
                self.left_out[f"<{local(element)}>"] += 1
        if not found:
            raise WorldFileError(f"{self.place.name}: there is no model in it")
        return found

    # ------------------------------------------------------------ models

    def _body(self, element: Element) -> Model:
        pose, name, kind = frames.IDENTITY, element.get("name", ""), ""
        if local(element) == "model":
            pose = _pose(element, self.place.name)
            kind = next((text(child(i, "uri")).removeprefix(SCHEME) for i in children(element, "include")), "")
            shapes = self._in_model(element, frames.IDENTITY, self.place, 1)
        else:
            kind = text(child(element, "uri")).removeprefix(SCHEME)
            name = text(child(element, "name")) or kind
            shapes = self._included(element, frames.IDENTITY, self.place, 1)
        if not name:
            raise WorldFileError(f"{self.place.name}: a model has no name")
        return Model(name, kind, pose, tuple(shapes))

    def _in_model(self, model: Element, above: Array, place: Path, depth: int) -> Iterator[Shape]:
        """The shapes of a model whose frame stands at `above` in the body's."""
        self._count_model(place, depth)
        for part in model:
            kind = local(part)
            if kind == "link":
                yield from self._in_link(part, frames.compose(above, _pose(part, place.name)), place)
            elif kind == "model":
                yield from self._in_model(part, frames.compose(above, _pose(part, place.name)), place, depth + 1)
            elif kind == "include":
                yield from self._included(part, above, place, depth + 1)
            elif kind == "joint":
                self.left_out["<joint>"] += 1

    def _included(self, include: Element, above: Array, place: Path, depth: int) -> Iterator[Shape]:
        """The shapes of another file's model. A pose of the include takes the place of the model's own, as SDFormat has it."""
        self._count_model(place, depth)
        uri = text(child(include, "uri"))
        folder = self._folder(uri, place.name)
        file = _model_file(folder)
        model = child(self._document(file), "model")
        if model is None:
            raise WorldFileError(f"{file.parent.name}/{file.name}: there is no model in it")
        pose = _pose(include if child(include, "pose") is not None else model, place.name)
        yield from self._in_model(model, frames.compose(above, pose), file, depth + 1)

    def _count_model(self, place: Path, depth: int) -> None:
        self._read += 1
        if depth > MAX_NESTING:
            raise WorldFileError(f"{place.name}: models include each other more than {MAX_NESTING} deep: does one include itself?")
        if self._read > MAX_MODELS:
            raise WorldFileError(f"{place.name}: more than {MAX_MODELS:,} models with all that they include")

    def _in_link(self, link: Element, above: Array, place: Path) -> Iterator[Shape]:
        for collision in children(link, "collision"):
            where = f"{place.parent.name}/{place.name}: collision {said(collision.get('name', ''))}"
            found = self._shape(child(collision, "geometry"), where, place)
            self._shapes += 1
            if self._shapes > MAX_SHAPES:
                raise WorldFileError(f"{place.name}: more than {MAX_SHAPES:,} collision shapes")
            if found is not None:
                yield Shape(found, frames.compose(above, _pose(collision, place.name)))

    # ------------------------------------------------------------ shapes

    def _shape(self, geometry: Element | None, where: str, place: Path) -> Solids | None:
        for form in () if geometry is None else geometry:
            kind = local(form)
            if kind == "mesh":
                return self._mesh(form, where, place)
            if kind == "box":
                return _box(_sizes(form, ("size",), 3, where))
            if kind == "cylinder":
                return solids(*cylinder(*_sizes(form, ("radius", "length"), 2, where)))
            if kind == "sphere":
                return solids(*sphere(*_sizes(form, ("radius",), 1, where)))
            self.left_out[f"<{kind[:40]}>"] += 1
        return None

    def _mesh(self, form: Element, where: str, place: Path) -> Solids:
        if child(form, "submesh") is not None:
            raise WorldFileError(f"{where}: a submesh is not read: give it a file of its own")
        scale = numbers(text(child(form, "scale")) or "1 1 1", 3, where, 1e6)
        if (scale == 0).any():
            raise WorldFileError(f"{where}: a scale of 0 leaves nothing")
        uri = text(child(form, "uri"))
        if uri.startswith(SCHEME):
            name, _, rest = uri.removeprefix(SCHEME).partition("/")
            file = beneath(self._folder(f"{SCHEME}{name}", place.name), rest, place.name)
        else:
            file = beneath(place.parent, uri, place.name)
        key = file, tuple(scale.tolist())
        if key not in self._meshes:
            if not file.is_file():
                raise WorldFileError(f"{where}: there is no mesh {said(uri)}")
            vertices, triangles = load_mesh(file)
            vertices = within_reach(vertices * scale, file.name)
            found = solids(vertices, triangles if np.prod(scale) > 0 else triangles[:, ::-1])
            if not len(found.boxes) + len(found.meshes):
                raise WorldFileError(f"{where}: the mesh {file.name} has no surface")
            self._meshes[key] = found
        return self._meshes[key]

    # ------------------------------------------------------------ files

    def _folder(self, uri: str, name: str) -> Path:
        """The folder of a model:// name. WorldFileError where it lies elsewhere than in `models`, or isn't there."""
        if not uri.startswith(SCHEME):
            raise WorldFileError(f"{name}: only {SCHEME} names are included, not {said(uri)}: download it and name it so")
        wanted = uri.removeprefix(SCHEME).rstrip("/")
        for folder in self.models:
            place = beneath(folder, wanted, name)
            if place.is_dir():
                return place
        raise WorldFileError(f"{name}: there is no model {said(uri)} in {', '.join(f.name or '.' for f in self.models)}")

    def _document(self, place: Path) -> Element:
        if place not in self._documents:
            root = xml(read(place), f"{place.parent.name}/{place.name}")
            if local(root) not in ("sdf", "gazebo"):
                raise WorldFileError(f"{place.name}: is no SDF, its root is <{local(root)[:40]}>")
            self._documents[place] = root
        return self._documents[place]


def _model_file(folder: Path) -> Path:
    """The file that a model's model.config names, the one of the newest format last; model.sdf without one."""
    config = folder / "model.config"
    name = "model.sdf"
    if config.is_file():
        named = [text(e) for e in children(xml(read(config), f"{folder.name}/{config.name}"), "sdf") if text(e)]
        name = named[-1] if named else name
    file = beneath(folder, name, f"{folder.name}/model.config")
    if not file.is_file():
        raise WorldFileError(f"{folder.name}: the model has no file {said(name)}")
    return file


def _pose(element: Element, name: str) -> Array:
    """(7,): the pose of an element in the frame of the one that holds it."""
    pose = child(element, "pose")
    if pose is None or not text(pose):
        return frames.IDENTITY
    where = f"{name}: the pose of {said(element.get('name', local(element)))}"
    frame = pose.get("relative_to") or pose.get("frame") or ""
    if frame not in ("", "world", "__model__"):
        raise WorldFileError(f"{where}: is told in the frame {said(frame)}, and only its parent's is read")
    if pose.get("rotation_format") == "quat_xyzw":
        values = numbers(text(pose), 7, where)
        if not np.linalg.norm(values[3:]) > 1e-6:
            raise WorldFileError(f"{where}: its quaternion has no length")
        return np.concatenate([values[:3], frames.normalise(values[[6, 3, 4, 5]])])
    values = numbers(text(pose), 6, where)
    roll, pitch, yaw = np.deg2rad(values[3:]) if pose.get("degrees") in ("1", "true") else values[3:]
    return np.concatenate([values[:3], frames.from_euler(yaw, pitch, roll)])


def _sizes(form: Element, tags: tuple[str, ...], count: int, where: str) -> Array:
    values = numbers(" ".join(text(child(form, tag)) for tag in tags), count, where)
    if (values <= 0).any():
        raise WorldFileError(f"{where}: its measures {said(' '.join(f'{v:g}' for v in values))} must be above 0")
    return values


def _box(size: Array) -> Solids:
    return Solids(
        Boxes(np.zeros((1, 3)), frames.IDENTITY[None, 3:], size[None] / 2, body=np.zeros(1), material=np.zeros(1)), Meshes.empty()
    )
