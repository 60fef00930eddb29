"""Reflections of the first order by the image method: off the floor, walls and large flat faces.

A face mirrors the tag; where the straight line from the antenna to that image passes through the face, there is a path of
the line's length, with

    g = (λ / 4π d) · √(G_a(θ) · G_t · χ) · Γ · 10^(-A/20)

where θ is the angle at which it leaves the antenna and A what stands on its two legs. Γ follows from the Fresnel equations
(ITU-R P.2040-3, section 2.2.2) and the face's complex permittivity η = ε' - jσ/(2π f ε0):

    Γ_TE = (cos i - √(η - sin² i)) / (cos i + √(η - sin² i))      Γ_TM = (η cos i - √(η - sin² i)) / (η cos i + √(η - sin² i))

and -1, +1 for a perfect conductor. Half of a circular wave's power lies in either. A linear tag takes a mixture that depends on how
it hangs; here the mean power is taken, with the phase of the TE part, and how the tag hangs counts by its own pattern alone
(`testbed.radio.coupling`, with the tag's mirror image: on metal that is exact):

    Γ = √((|Γ_TE|² + |Γ_TM|²) / 2) · exp(j arg Γ_TE)

TE, because a field along the face turns over at every angle and on every material, whereas the sign of the TM part as the
tag sees it is a matter of the tag's own direction. At grazing incidence on a dielectric, and at a right angle on
anything, this is what both parts have in common; on metal it is -1 at all angles.

Left out: that a dielectric turns the polarisation, second and higher orders, the edges of a face (a path is there or not), roughness,
waves that come back from inside or behind a thin wall, and moving faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array, Table, column
from testbed.plugins import suggest
from testbed.protocols import Obstruction
from testbed.radio.materials import FREQUENCY, MATERIALS
from testbed.radio.mesh_faces import rectangles
from testbed.radio.sight import Obstacles
from testbed.scene import Scene
from testbed.solid import holder, mesh_holder

ELECTRIC_CONSTANT = 8.8541878188e-12  # F/m (CODATA 2022)
LARGE = 2.0  # m²: about the first Fresnel zone on a face half-way along 8 m, π λ d / 4; a smaller face reflects less than all
ASIDE = 1e-4  # m off a face: where legs end, so that they don't meet the face itself
COVERED = 0.01  # m off a face: what is inside another box there can't be seen


@dataclass(frozen=True)
class Dielectric:
    """Relative permittivity ε' and conductivity σ (S/m) at 870 MHz, and where they come from."""

    permittivity: float
    conductivity: float
    source: str


def _p2040(permittivity: float, c: float, d: float) -> Dielectric:
    return Dielectric(permittivity, c * FREQUENCY**d, f"ITU-R P.2040-3, Table 3: {permittivity}, {c} f^{d}")


def _lossy(name: str, permittivity: float) -> Dielectric:
    """Conductivity from the loss that `testbed.radio.materials` gives it: σ = √ε' / 1636 for each dB/m (ITU-R P.2040-3)."""
    conductivity = MATERIALS[name].per_metre_db * np.sqrt(permittivity) / 1636
    return Dielectric(permittivity, float(conductivity), "permittivity an engineering value; conductivity from its loss per metre")


# None is a perfect conductor
DIELECTRICS: dict[str, Dielectric | None] = {
    "steel": None,
    "rack_bay": _lossy("rack_bay", 2.0),
    "carton": _lossy("carton", 1.6),
    "liquid_pallet": Dielectric(78.0, 0.16, "water at 25 °C, single Debye relaxation of 8.3 ps; gaps between the vessels left out"),
    "person": Dielectric(55.0, 0.94, "muscle at 900 MHz: Gabriel, Lau, Gabriel, Phys. Med. Biol. 41 (1996)"),
    "rubber": _lossy("rubber", 5.0),
    "plastic": Dielectric(2.3, 0.0, "polyethylene"),
    "wood": _p2040(1.99, 0.0047, 1.0718),
    "concrete": _p2040(5.24, 0.0462, 0.7822),
    "glass": _p2040(6.31, 0.0036, 1.3394),
}


def permittivities(names: tuple[str, ...]) -> Array:
    """(materials,) complex relative permittivity at 870 MHz; infinite for a conductor. ValueError for an unknown name."""
    for name in names:
        if name not in DIELECTRICS:
            raise ValueError(f"nobody knows how {name!r} reflects{suggest(name, list(DIELECTRICS))}")
    scale = 2 * np.pi * FREQUENCY * 1e9 * ELECTRIC_CONSTANT
    chosen = [DIELECTRICS[name] for name in names]
    return np.array([complex(np.inf) if d is None else d.permittivity - 1j * d.conductivity / scale for d in chosen], dtype=np.complex128)


def fresnel(permittivity: ArrayLike, cosine: ArrayLike) -> tuple[Array, Array]:
    """(Γ_TE, Γ_TM), complex, for the cosine of the angle of incidence; an infinite permittivity is a perfect conductor."""
    eta, c = np.broadcast_arrays(np.asarray(permittivity, dtype=np.complex128), np.asarray(cosine, dtype=np.float64))
    metal = np.isinf(eta)
    eta = np.where(metal, 1.0, eta)
    root = np.sqrt(eta - (1 - c * c))
    with np.errstate(invalid="ignore", divide="ignore"):
        te, tm = (c - root) / (c + root), (eta * c - root) / (eta * c + root)
    return np.where(metal, -1.0, te), np.where(metal, 1.0, tm)


def mixed(te: Array, tm: Array) -> Array:
    """Γ of a circular wave on a linear tag: the mean power of both parts, the phase of the TE part."""
    return np.sqrt((np.abs(te) ** 2 + np.abs(tm) ** 2) / 2) * np.exp(1j * np.angle(te))


# ---------------------------------------------------------------- faces


@dataclass(frozen=True, eq=False)
class Reflectors(Table):
    """Flat rectangles that reflect to the side of their normal. `box` is the piece of the scene, a box or a mesh, -1 for the floor."""

    origin: Array = column("float64", ("N", 3), "m, the middle")
    normal: Array = column("float64", ("N", 3))
    u: Array = column("float64", ("N", 3), "along one edge")
    v: Array = column("float64", ("N", 3), "along the other")
    half: Array = column("float64", ("N", 2), "m, half the edges along u and v")
    permittivity: Array = column("complex128", unit="infinite for a conductor")
    box: Array = column("int64", default=-1)


def reflectors(scene: Scene, min_area: float = LARGE, floor: str | None = "concrete") -> Reflectors:
    """Faces of at least `min_area` m² of what never moves, and the floor of the hall (`scene.bounds`) of material `floor`.

    Faces that look out of the hall, or that other things cover, are left out, and those of meshes that are no rectangles. ValueError
    for a material that isn't known.
    """
    faces = _faces(scene, min_area)
    if len(scene.meshes):
        faces = Reflectors.concatenate([faces, *_mesh_faces(scene, min_area)])
    faces = faces.take(_visible(faces, scene))
    if floor is None:
        return faces
    low, high = scene.bounds
    ground = Reflectors(
        origin=np.array([[*(low + high)[:2] / 2, low[2]]]),
        normal=np.array([[0.0, 0.0, 1.0]]),
        u=np.array([[1.0, 0.0, 0.0]]),
        v=np.array([[0.0, 1.0, 0.0]]),
        half=(high - low)[None, :2] / 2,
        permittivity=permittivities((floor,)),
    )
    return Reflectors.concatenate([ground, faces])


def _faces(scene: Scene, min_area: float) -> Reflectors:
    moving = np.isin(scene.boxes.body, scene.moving)
    boxes, index = scene.static_boxes(), np.flatnonzero(~moving)
    eta, axes = permittivities(scene.materials), np.moveaxis(frames.matrix(boxes.quaternion), -1, -2)
    parts = []
    for axis, sign in product(range(3), (1.0, -1.0)):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        own = np.flatnonzero(4 * boxes.half[:, first] * boxes.half[:, second] >= min_area)
        normal = sign * axes[own, axis]
        parts.append(
            Reflectors(
                origin=boxes.center[own] + normal * boxes.half[own, axis, None],
                normal=normal,
                u=axes[own, first],
                v=axes[own, second],
                half=boxes.half[own][:, [first, second]],
                permittivity=eta[boxes.material[own]],
                box=index[own],
            )
        )
    return Reflectors.concatenate(parts)


def _mesh_faces(scene: Scene, min_area: float) -> list[Reflectors]:
    eta = permittivities(scene.materials)
    return [
        Reflectors(
            origin=face.origin[None],
            normal=face.normal[None],
            u=face.u[None],
            v=face.v[None],
            half=face.half[None],
            permittivity=eta[scene.meshes.material[[face.mesh]]],
            box=np.array([len(scene.boxes) + face.mesh]),
        )
        for face in rectangles(scene.static_meshes(), min_area)
    ]


def _visible(faces: Reflectors, scene: Scene) -> Array:
    """(N,) bool: the face looks into the hall, and some place on it isn't inside another thing."""
    corners = np.array([[(scene.bounds[i, 0], scene.bounds[j, 1], scene.bounds[k, 2])] for i, j, k in product((0, 1), repeat=3)])
    inward = np.einsum("cni,ni->cn", corners - faces.origin, faces.normal).max(axis=0, initial=-np.inf) > COVERED
    boxes, meshes, seen = scene.static_boxes(), scene.static_meshes(), np.zeros(len(faces), dtype=bool)
    for across, along in product((0.0, -0.9, -0.45, 0.45, 0.9), repeat=2):
        open_ = np.flatnonzero(inward & ~seen)
        out = faces.origin[open_] + COVERED * faces.normal[open_]
        out += across * faces.half[open_, :1] * faces.u[open_] + along * faces.half[open_, 1:] * faces.v[open_]
        seen[open_] = (holder(out, boxes) < 0) & (mesh_holder(out, meshes) < 0)
    return seen


# ---------------------------------------------------------------- paths


@dataclass(frozen=True, eq=False)
class Bounces(Table):
    """Paths by one reflection: whose link, off which reflector, where, how long the path is, and Γ."""

    link: Array = column("int64")
    reflector: Array = column("int64")
    point: Array = column("float64", ("N", 3), "m, on the face")
    length: Array = column("float64", unit="m")
    coefficient: Array = column("complex128")


def bounces(start: Array, end: Array, faces: Reflectors) -> Bounces:
    """All first-order reflections of L links from `start` (L, 3) to `end` (L, 3), obstacles aside, by link and then by face."""
    planes = np.concatenate([faces.origin, faces.normal, faces.u, faces.v, faces.half], axis=1)
    found, number = _mirror(np.concatenate([start, end], axis=1), planes)
    face, cosine = found[:, 1], number[:, 4]
    coefficient = mixed(*fresnel(faces.permittivity[face], cosine))
    return Bounces(link=found[:, 0], reflector=face, point=number[:, :3], length=number[:, 3], coefficient=coefficient)


class Mirrored(Obstacles):
    """Obstacles as a reflected wave meets them: rays of path i that pass the plane of its face go on mirrored in front of it.

    So the reflected path is the straight line from the antenna to the tag's image, with a Fresnel zone of its own, and all
    that is done with straight lines (`testbed.radio.sight`) does for it. The plane is taken to go on beyond the face.
    """

    def __init__(self, obstacles: Obstacles, paths: Bounces, faces: Reflectors) -> None:
        """`obstacles` know the paths as their links."""
        self._obstacles = obstacles
        self._origin, self._normal = faces.origin[paths.reflector], faces.normal[paths.reflector]

    def on(self, link: Array, start: Array, end: Array) -> Obstruction:
        """Obstruction of rays (M, 3) to (M, 3), each of the path `link` (M,)."""
        a, b, turn, share = self._folded(link, start, end)
        both = np.flatnonzero((share > 0) & (share < 1))
        first_end = np.array(b)
        first_end[both] = turn[both]
        found = self._obstacles.on(link, a, first_end)
        after = self._obstacles.on(link[both], turn[both], b[both])
        count, loss = np.array(found.count), np.array(found.loss)
        count[both] += after.count
        loss[both] += after.loss
        return Obstruction(count=count, loss=loss)

    def extent(self, link: Array, start: Array, end: Array) -> tuple[Array, Array, Array]:
        """(ray (C,), from (C,), to (C,)): every box on every ray, and between which shares of the ray's length."""
        a, b, turn, share = self._folded(link, start, end)
        one, both = np.flatnonzero((share <= 0) | (share >= 1)), np.flatnonzero((share > 0) & (share < 1))
        parts = [
            (one, a[one], b[one], np.zeros(len(one)), np.ones(len(one))),
            (both, a[both], turn[both], np.zeros(len(both)), share[both]),
            (both, turn[both], b[both], share[both], np.ones(len(both))),
        ]
        found = []
        for rays, p, q, low, high in parts:
            ray, enter, leave = self._obstacles.extent(link[rays], p, q)
            width = (high - low)[ray]
            found.append((rays[ray], low[ray] + enter * width, low[ray] + leave * width))
        ray, enter, leave = (np.concatenate(column) for column in zip(*found, strict=True))
        return ray, enter, leave

    def _folded(self, link: Array, start: Array, end: Array) -> tuple[Array, Array, Array, Array]:
        """Both ends (M, 3) brought in front of the face, where the ray turns (M, 3), and at which share of it (M,)."""
        origin, normal = self._origin[link], self._normal[link]
        above = [np.einsum("ij,ij->i", point - origin, normal) for point in (start, end)]
        a, b = (p - np.minimum(2 * h, 0.0)[:, None] * normal for p, h in zip((start, end), above, strict=True))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(above[0] * above[1] < 0, above[0] / (above[0] - above[1]), 0.0)
        return a, b, start + share[:, None] * (end - start) + ASIDE * normal, share


def images(paths: Bounces, end: Array, faces: Reflectors) -> Array:
    """(M, 3) m: the tags' images behind the faces; `end` (L, 3) are the links' tags."""
    tag, normal = end[paths.link], faces.normal[paths.reflector]
    return tag - 2 * np.einsum("ij,ij->i", tag - faces.origin[paths.reflector], normal)[:, None] * normal


def mirrored_axis(axis: Array, paths: Bounces, faces: Reflectors) -> Array:
    """(M, 3): the dipoles `axis` (M, 3) of the paths' tags as the images have them; the sign, which no power knows, is left as it is."""
    normal = faces.normal[paths.reflector]
    return axis - 2 * np.einsum("ij,ij->i", axis, normal)[:, None] * normal


@njit(cache=True)
def _mirror(ends, planes):
    """Every (line, face) with both ends before the face and the reflecting point on it; and that point, length, cosine of incidence.

    ends (L, 6): start, end; planes (F, 14): origin, normal, u, v, half
    """
    found, pair, number = 0, np.empty((1024, 2), dtype=np.int64), np.empty((1024, 5))
    for i in range(len(ends)):
        for k in range(len(planes)):
            above_a = _beyond(ends, i, 0, planes, k, 3)
            if above_a <= 0.0:
                continue
            above_b = _beyond(ends, i, 3, planes, k, 3)
            if above_b <= 0.0:
                continue
            share, drop = above_a / (above_a + above_b), above_a + above_b
            ua, va = _beyond(ends, i, 0, planes, k, 6), _beyond(ends, i, 0, planes, k, 9)
            along_u, along_v = _beyond(ends, i, 3, planes, k, 6) - ua, _beyond(ends, i, 3, planes, k, 9) - va
            pu, pv = ua + share * along_u, va + share * along_v
            if abs(pu) > planes[k, 12] or abs(pv) > planes[k, 13]:
                continue
            if found == len(pair):
                pair, number = np.concatenate((pair, pair)), np.concatenate((number, number))
            length = np.sqrt(along_u * along_u + along_v * along_v + drop * drop)
            pair[found, 0], pair[found, 1] = i, k
            for axis in range(3):
                number[found, axis] = planes[k, axis] + pu * planes[k, 6 + axis] + pv * planes[k, 9 + axis]
            number[found, 3], number[found, 4] = length, drop / length
            found += 1
    return pair[:found], number[:found]


@njit(cache=True)
def _beyond(points, i, at, planes, k, axis):
    """How far the point in columns `at` of row i lies from the origin of plane k along the plane's direction in columns `axis`."""
    total = 0.0
    for j in range(3):
        total += (points[i, at + j] - planes[k, j]) * planes[k, axis + j]
    return total
