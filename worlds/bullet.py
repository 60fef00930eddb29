"""PyBullet, behind one door: the only module that imports it, so that its traps are worked round in one place.

Outside this file quaternions are (w, x, y, z), inside PyBullet they are (x, y, z, w); poses are those of a body's own frame,
PyBullet's are those of its centre of mass. Importing this module imports nothing of PyBullet: that happens with the first
`Client`, and where it is missing `PybulletMissing` says how to get it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import cache
from importlib import metadata
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes
from testbed.scene import Scene
from worlds import urdf
from worlds.bullet_records import Contacts, Handle, Hits, StaticPart
from worlds.captured import captured

RAYS_PER_CALL = 8192  # of exactly 16,384 rays PyBullet drops the last (from a list) or all (from an array): stay at half of it
BASE = -1  # PyBullet's link index of a model's first link
NOTHING = -1  # body of a ray that hit nothing


class PybulletMissing(ImportError):
    """PyBullet is not installed; the message says how to install it."""


@cache
def _pybullet() -> Any:
    try:
        with captured():  # it prints its build time when imported
            import pybullet
    except ImportError as error:
        raise PybulletMissing(
            f"PyBullet can't be imported ({error}): pip install 'warehouse-radio-testbed[sim]', at best under Python 3.11, "
            "the last one with a ready wheel"
        ) from error
    return pybullet


def version() -> str:
    """PyBullet's version, "3.2.7". PybulletMissing where there is none."""
    _pybullet()
    return metadata.version("pybullet")


def numpy_enabled() -> bool:
    """Whether PyBullet was built with numpy: else camera images come as tuples. PybulletMissing where there is none."""
    return bool(_pybullet().isNumpyEnabled())


class Client:
    """One physics world without a window. Use it in a `with`, or call `close`: an open one holds some 30 MB.

    Everything that PyBullet does holds the interpreter lock: run several in processes, never in threads.
    """

    def __init__(self, step_s: float = 1 / 240, gravity: float = 9.81, solver_iterations: int = 50) -> None:
        if not (0 < step_s <= 0.1 and np.isfinite(gravity)):
            raise ValueError(f"a physics step of {step_s} s under {gravity} m/s²: the step must lie in (0, 0.1] s and gravity be finite")
        self.step_s, self.gravity, self.solver_iterations = step_s, gravity, solver_iterations
        self._p = _pybullet()
        with captured():
            self._id: int = self._p.connect(self._p.DIRECT)
        if self._id < 0:
            raise RuntimeError("PyBullet opened no physics client: too many are open in this process")
        self._names: dict[int, str] = {}
        self._configure()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the memory back. Closing twice is harmless."""
        if self._id >= 0:
            with captured():
                self._p.disconnect(physicsClientId=self._id)
            self._id = -1

    def reset(self) -> None:
        """An empty world again, exactly as new: every trial begins here, so none depends on the one before."""
        with captured():
            self._p.resetSimulation(physicsClientId=self._id)
        self._names.clear()
        self._configure()  # a reset forgets gravity and step

    def _configure(self) -> None:
        self._p.setGravity(0, 0, -self.gravity, physicsClientId=self._id)
        # pairs in a set order make runs bit-identical across processes. File caching would answer a second model that is
        # written under an old name with the first one, without an error
        self._p.setPhysicsEngineParameter(
            fixedTimeStep=self.step_s,
            numSolverIterations=self.solver_iterations,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            physicsClientId=self._id,
        )

    # ------------------------------------------------------------ bodies

    def load(self, text: str, name: str, pose: ArrayLike = frames.IDENTITY, *, fixed: bool = False) -> Handle:
        """A body from URDF text (`worlds.urdf`), its base's frame at `pose` (7,), tested by a ray. `fixed` nails it to the world.

        Its joints run free, without PyBullet's default motors. ValueError, with PyBullet's own words, for a model that it refuses.
        """
        pose = _checked_pose(pose, name)
        with tempfile.NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file, captured() as said:
            file.write(text)
            file.flush()
            try:
                uid = self._p.loadURDF(
                    file.name,
                    basePosition=pose[:3].tolist(),
                    baseOrientation=_xyzw(pose[3:]),
                    useFixedBase=fixed,
                    flags=self._p.URDF_USE_INERTIA_FROM_FILE,  # else moments are made up from bounding boxes
                    physicsClientId=self._id,
                )
            except self._p.error as error:
                said.seek(0)
                raise ValueError(f"{name}: PyBullet can't load its model: {error} {said.read().strip()}") from None
        handle = self._handle(uid, name)
        self._place(handle, pose)  # the loader reads the pose in single precision
        self.free(handle, list(handle.joints))
        self._self_test(handle)
        return handle

    def load_static(self, scene: Scene) -> list[StaticPart]:
        """All bodies of the scene that never move: one compound for each body and material, so that a ray's hit tells both.

        Few compounds instead of many bodies, because every separate body costs time in each step.
        """
        boxes, parts = scene.static_boxes(), []
        keys = np.stack([boxes.body, boxes.material], axis=1).astype(np.int64)
        for body, material in np.unique(keys, axis=0):
            name = f"{scene.bodies[body].name if body >= 0 else 'world'}/{scene.materials[material]}"
            own = boxes.take((keys == (body, material)).all(axis=1))
            parts.append(StaticPart(self.load_boxes(own, name), int(body), int(material)))
        meshes = scene.static_meshes()
        for m in range(len(meshes)):
            body, material = int(meshes.body[m]), int(meshes.material[m])
            name = f"{scene.bodies[body].name}/{scene.materials[material]}"
            parts.append(StaticPart(self.load_mesh(meshes.take(np.arange(len(meshes)) == m), name), body, material))
        return parts

    def load_boxes(self, boxes: Boxes, name: str, pose: ArrayLike = frames.IDENTITY) -> Handle:
        """One fixed compound of `boxes`, which are in the frame `pose`."""
        return self.load(urdf.compound(name, boxes), name, pose, fixed=True)

    def load_box(self, half: ArrayLike, pose: ArrayLike, name: str) -> Handle:
        """One fixed box with half edges `half` (3,) around `pose` (7,), which is its frame."""
        pose, half = _checked_pose(pose, name), np.asarray(half, dtype=np.float64).tolist()
        shape = self._p.createCollisionShape(self._p.GEOM_BOX, halfExtents=half, physicsClientId=self._id)
        uid = self._p.createMultiBody(0, shape, basePosition=pose[:3].tolist(), baseOrientation=_xyzw(pose[3:]), physicsClientId=self._id)
        handle = self._handle(uid, name)
        self._self_test(handle)
        return handle

    def load_mesh(self, meshes: Meshes, name: str) -> Handle:
        """One fixed body of the triangles of `meshes`, in the world frame: concave, as only what never moves may be, without an inside."""
        shape = self._p.createCollisionShape(
            self._p.GEOM_MESH,
            vertices=meshes.vertices.tolist(),
            indices=meshes.triangles.ravel().tolist(),
            flags=self._p.GEOM_FORCE_CONCAVE_TRIMESH,  # without it the engine takes the hull
            physicsClientId=self._id,
        )
        handle = self._handle(self._p.createMultiBody(0, shape, physicsClientId=self._id), name)
        self.refresh()
        corners = meshes.corners()
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        largest = int(np.linalg.norm(normal, axis=1).argmax())
        middle, way = corners[largest].mean(axis=0), normal[largest] / np.linalg.norm(normal[largest])
        self._assert_hit(handle, BASE, middle + 0.01 * way, middle - 0.01 * way)
        return handle

    def load_floor(self, height: float = 0.0, friction: float = 0.8) -> Handle:
        """An endless level floor. A plane: wheels on it never meet the seams and edges that boxes have."""
        shape = self._p.createCollisionShape(self._p.GEOM_PLANE, planeNormal=[0, 0, 1], physicsClientId=self._id)
        uid = self._p.createMultiBody(0, shape, basePosition=[0, 0, height], physicsClientId=self._id)
        handle = self._handle(uid, "floor")
        self.surface(handle, friction=friction)
        self._assert_hit(handle, BASE, np.array([0.0, 0.0, height + 1.0]), np.array([0.0, 0.0, height - 1.0]))
        return handle

    def remove(self, handle: Handle) -> None:
        """Take a body out of the world."""
        self._p.removeBody(handle.uid, physicsClientId=self._id)
        del self._names[handle.uid]

    def name(self, uid: int) -> str:
        """Name of the body that a hit or a contact speaks of."""
        return self._names[uid]

    def surface(self, handle: Handle, link: int = BASE, *, friction: float = 0.8, rolling: float = 0.0, spinning: float = 0.0) -> None:
        """Friction coefficients of one link: sliding, and resistance to rolling and to spinning (m)."""
        self._p.changeDynamics(
            handle.uid, link, lateralFriction=friction, rollingFriction=rolling, spinningFriction=spinning, physicsClientId=self._id
        )

    def damping(self, handle: Handle, linear: float = 0.0, angular: float = 0.0) -> None:
        """Drag on a body as a fraction of its speed per second. PyBullet's own default of 0.04 slows a free body visibly."""
        self._p.changeDynamics(handle.uid, BASE, linearDamping=linear, angularDamping=angular, physicsClientId=self._id)

    # ------------------------------------------------------------ motion

    def pose(self, handle: Handle) -> Array:
        """(7,): where the body's own frame is now."""
        position, quaternion = self._p.getBasePositionAndOrientation(handle.uid, physicsClientId=self._id)
        return frames.compose(np.array([*position, *_wxyz(quaternion)]), _inverse(handle.com))

    def centre(self, handle: Handle) -> tuple[float, ...]:
        """Where the centre of mass is now, (x, y, z, qw, qx, qy, qz): plain floats without numpy, for drivers, who look at every step."""
        position, quaternion = self._p.getBasePositionAndOrientation(handle.uid, physicsClientId=self._id)
        return (*position, *_wxyz(quaternion))

    def put(self, handle: Handle, centre: Sequence[float]) -> None:
        """`place` by the pose (7,) of the centre of mass, unchecked, for bodies that are moved at every step."""
        x, y, z, qw, qx, qy, qz = centre
        self._p.resetBasePositionAndOrientation(handle.uid, (x, y, z), (qx, qy, qz, qw), physicsClientId=self._id)

    def poses(self, handles: Sequence[Handle]) -> Array:
        """(n, 7): where the frames of some bodies are now."""
        return np.array([self.pose(h) for h in handles]).reshape(-1, 7)

    def place(self, handle: Handle, pose: ArrayLike) -> None:
        """Put the body's frame at `pose` (7,), standing still. Call `refresh` after the last one and before casting rays."""
        self._place(handle, _checked_pose(pose, handle.name))

    def _place(self, handle: Handle, pose: Array) -> None:
        com = frames.compose(pose, handle.com)
        self._p.resetBasePositionAndOrientation(handle.uid, com[:3].tolist(), _xyzw(com[3:]), physicsClientId=self._id)

    def refresh(self) -> None:
        """Bring contacts up to date with placed bodies. (Rays follow by themselves in PyBullet 3.2.7; that is promised nowhere.)"""
        self._p.performCollisionDetection(physicsClientId=self._id)

    def velocity(self, handle: Handle) -> Array:
        """(6,): m/s of the centre of mass and rad/s, world frame."""
        linear, angular = self._p.getBaseVelocity(handle.uid, physicsClientId=self._id)
        return np.array([*linear, *angular])

    def set_velocity(self, handle: Handle, velocity: ArrayLike) -> None:
        """Give the body a velocity (6,): m/s of the centre of mass and rad/s, world frame."""
        v = np.asarray(velocity, dtype=np.float64).tolist()
        self._p.resetBaseVelocity(handle.uid, v[:3], v[3:], physicsClientId=self._id)

    def joint_states(self, handle: Handle, joints: Sequence[str]) -> Array:
        """(n, 2): position (rad or m) and rate of the named joints."""
        states = self._p.getJointStates(handle.uid, [handle.joints[j] for j in joints], physicsClientId=self._id)
        return np.array([state[:2] for state in states]).reshape(-1, 2)

    def place_joint(self, handle: Handle, joint: str, position: float, rate: float = 0.0) -> None:
        """Set a joint's position (rad or m) and rate outright."""
        self._p.resetJointState(handle.uid, handle.joints[joint], position, rate, physicsClientId=self._id)

    def drive(self, handle: Handle, joints: Sequence[str], rates: ArrayLike, force: float) -> None:
        """Turn joints at `rates` (n,) rad/s or m/s with motors of at most `force` N m or N each, until told otherwise."""
        self._motors(handle, joints, self._p.VELOCITY_CONTROL, force, targetVelocities=np.asarray(rates, dtype=np.float64).tolist())

    def steer(self, handle: Handle, joints: Sequence[str], positions: ArrayLike, force: float) -> None:
        """Hold joints at `positions` (n,) rad or m with motors of at most `force` each, until told otherwise."""
        self._motors(handle, joints, self._p.POSITION_CONTROL, force, targetPositions=np.asarray(positions, dtype=np.float64).tolist())

    def free(self, handle: Handle, joints: Sequence[str]) -> None:
        """Switch motors off. PyBullet gives every new joint one that brakes it: a wheel would be dragged, not roll."""
        self._motors(handle, joints, self._p.VELOCITY_CONTROL, 0.0, targetVelocities=[0.0] * len(joints))

    def _motors(self, handle: Handle, joints: Sequence[str], mode: int, force: float, **targets: list[float]) -> None:
        if joints:
            numbers = [handle.joints[j] for j in joints]
            self._p.setJointMotorControlArray(handle.uid, numbers, mode, forces=[force] * len(numbers), physicsClientId=self._id, **targets)

    def step(self, count: int = 1) -> None:
        """Let `count` steps of `step_s` pass."""
        for _ in range(count):
            self._p.stepSimulation(physicsClientId=self._id)

    def contacts(self, a: Handle, b: Handle | None = None) -> Contacts:
        """What body `a` touches (or whether it touches `b`), as of the last step or refresh."""
        other = {} if b is None else {"bodyB": b.uid}
        found = self._p.getContactPoints(bodyA=a.uid, physicsClientId=self._id, **other) or ()
        return Contacts(
            body=np.array([c[1:3] for c in found], dtype=np.int64).reshape(-1, 2),
            link=np.array([c[3:5] for c in found], dtype=np.int64).reshape(-1, 2),
            position=np.array([c[6] for c in found], dtype=np.float64).reshape(-1, 3),
            gap=np.array([c[8] for c in found], dtype=np.float64),
            force=np.array([c[9] for c in found], dtype=np.float64),
        )

    # ------------------------------------------------------------ rays

    def hits(self, start: ArrayLike, end: ArrayLike, number: int | None = None) -> Hits:
        """The first thing that each ray from `start` (N, 3) to `end` (N, 3) hits, or its `number`-th (from 0, in no order).

        A ray doesn't hit a shape that it starts in. ValueError for points that aren't finite: PyBullet would never return.
        """
        a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        if a.ndim != 2 or a.shape[1] != 3 or a.shape != b.shape:
            raise ValueError(f"rays want two arrays (N, 3), got {a.shape} and {b.shape}")
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            raise ValueError("rays want finite points")
        options = {} if number is None else {"reportHitNumber": number}
        rows: list[tuple[Any, ...]] = []
        for i in range(0, len(a), RAYS_PER_CALL):
            some = slice(i, i + RAYS_PER_CALL)
            got = self._p.rayTestBatch(a[some], b[some], numThreads=1, physicsClientId=self._id, **options)
            if len(got) != len(a[some]):
                raise RuntimeError(f"PyBullet answered {len(got)} of {len(a[some])} rays")
            rows += got
        body, link, fraction, position, normal = zip(*rows, strict=True) if rows else ((),) * 5
        return Hits(
            body=np.array(body, dtype=np.int64),
            link=np.array(link, dtype=np.int64),
            fraction=np.array(fraction, dtype=np.float64),
            position=np.array(position, dtype=np.float64).reshape(-1, 3),
            normal=np.array(normal, dtype=np.float64).reshape(-1, 3),
        )

    # ------------------------------------------------------------ inside

    def _handle(self, uid: int, name: str) -> Handle:
        if uid < 0:
            raise RuntimeError(f"PyBullet made no body of {name}")
        infos = [self._p.getJointInfo(uid, j, physicsClientId=self._id) for j in range(self._p.getNumJoints(uid, physicsClientId=self._id))]
        base = self._p.getBodyInfo(uid, physicsClientId=self._id)[0].decode()
        dynamics = self._p.getDynamicsInfo(uid, BASE, physicsClientId=self._id)
        self._names[uid] = name
        return Handle(
            name=name,
            uid=uid,
            joints={info[1].decode(): info[0] for info in infos},
            links={base: BASE} | {info[12].decode(): info[0] for info in infos},  # a joint and its child link share a number
            com=np.array([*dynamics[3], *_wxyz(dynamics[4])]),
        )

    def _self_test(self, handle: Handle) -> None:
        """A shape that PyBullet lost (a stale number, a list too long) makes a body that nothing touches, without an error."""
        self.refresh()
        tested = 0
        for link in handle.links.values():
            shapes = self._p.getCollisionShapeData(handle.uid, link, physicsClientId=self._id)
            if shapes:
                state = (
                    self._p.getBasePositionAndOrientation(handle.uid, physicsClientId=self._id)
                    if link == BASE
                    else self._p.getLinkState(handle.uid, link, computeForwardKinematics=1, physicsClientId=self._id)
                )
                center = frames.to_world([*state[0], *_wxyz(state[1])], shapes[0][5])
                top = self._p.getAABB(handle.uid, link, physicsClientId=self._id)[1][2]
                self._assert_hit(handle, link, np.array([*center[:2], top + 1.0]), center)
                tested += 1
        if not tested:
            raise RuntimeError(f"{handle.name} can't be hit by a ray: it has no collision shape")

    def _assert_hit(self, handle: Handle, link: int, above: Array, center: Array) -> None:
        number, found = 0, None
        while found != NOTHING:  # whatever else stands above it
            hit = self.hits([above], [center], number)
            found = int(hit.body[0])
            if (found, int(hit.link[0])) == (handle.uid, link):
                return
            number += 1
        raise RuntimeError(f"{handle.name} can't be hit by a ray from above: PyBullet lost its shape")


def base_poses(handle: Handle, centres: ArrayLike) -> Array:
    """(..., 7): poses of a body's own frame from those of its centre of mass (`Client.centre`)."""
    return frames.compose(centres, _inverse(handle.com))


def _xyzw(q: Array) -> list[float]:
    return [*q[1:].tolist(), float(q[0])]


def _wxyz(q: Sequence[float]) -> tuple[float, ...]:
    return (q[3], q[0], q[1], q[2])


def _inverse(pose: Array) -> Array:
    back = frames.conjugate(pose[3:])
    return np.concatenate([-frames.rotate(back, pose[:3]), back])


def _checked_pose(pose: ArrayLike, name: str) -> Array:
    p = np.asarray(pose, dtype=np.float64)
    if p.shape != (7,) or not np.isfinite(p).all() or abs(np.linalg.norm(p[3:]) - 1) > 1e-6:
        raise ValueError(f"{name}: a pose is x, y, z and a unit quaternion w, x, y, z, got {p}")
    return p
