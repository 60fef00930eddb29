import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from testbed import frames
from testbed.units import wrap, wrap_positive

angles = st.floats(-7, 7)
vectors = st.tuples(*[st.floats(-10, 10)] * 3).map(np.array)


def scipy_of(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


@given(angles, angles, angles, vectors)
def test_euler_angles_and_rotation_agree_with_scipy(yaw, pitch, roll, v):
    q = frames.from_euler(yaw, pitch, roll)
    peer = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    np.testing.assert_allclose(frames.rotate(q, v), peer.apply(v), atol=1e-9)
    np.testing.assert_allclose(frames.matrix(q), peer.as_matrix(), atol=1e-12)


@given(angles, angles, angles, angles)
def test_a_product_rotates_by_the_right_factor_first(yaw, pitch, yaw2, roll2):
    a, b = frames.from_euler(yaw, pitch), frames.from_euler(yaw2, 0.0, roll2)
    np.testing.assert_allclose(frames.matrix(frames.multiply(a, b)), (scipy_of(a) * scipy_of(b)).as_matrix(), atol=1e-12)


@given(vectors, vectors)
def test_an_antenna_looks_where_it_is_aimed(position, target):
    d = target - position
    if np.linalg.norm(d) > 1e-3:
        looking = frames.rotate(frames.looking_at(position, target), np.array([1.0, 0, 0]))
        np.testing.assert_allclose(looking, d / np.linalg.norm(d), atol=1e-9)


@given(angles, vectors, vectors)
def test_to_local_undoes_to_world(yaw, origin, point):
    pose = np.concatenate([origin, frames.from_euler(yaw, 0.3, -0.2)])
    np.testing.assert_allclose(frames.to_local(pose, frames.to_world(pose, point)), point, atol=1e-9)
    np.testing.assert_allclose(
        frames.compose(pose, np.concatenate([point, frames.from_euler(0.0)]))[:3], frames.to_world(pose, point), atol=1e-12
    )


def test_a_positive_pitch_looks_down():
    assert frames.rotate(frames.from_euler(0.0, 0.5), np.array([1.0, 0, 0]))[2] < 0


@given(st.floats(-1e6, 1e6))
def test_wrap_keeps_the_direction_and_the_interval(a):
    w, p = float(wrap(a)), float(wrap_positive(a))
    assert -np.pi < w <= np.pi
    assert 0 <= p < 2 * np.pi
    assert abs(np.exp(1j * w) - np.exp(1j * a)) < 1e-8
    assert abs(np.exp(1j * p) - np.exp(1j * a)) < 1e-8


def test_the_ends_of_wrap():
    assert wrap(np.pi) == np.pi
    assert wrap(-np.pi) == np.pi
    assert wrap_positive(-1e-20) == 0.0
    np.testing.assert_allclose(frames.yaw_of(frames.from_euler(2.0)), 2.0, atol=1e-15)
