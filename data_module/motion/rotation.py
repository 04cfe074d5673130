"""Rotations in numpy: quaternions (w first), exponential maps and Euler angles.

Conversions are those of `scipy.spatial.transform.Rotation`; this file adds continuity over time, the removal of yaw,
and interpolation.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.types import Array

__all__ = ["angle_between", "between", "conjugate", "continuous", "cross", "from_euler", "from_exponential_map",
           "interpolate", "multiply", "normalise", "remove_yaw", "rotate", "to_euler", "to_exponential_map",
           "to_matrix", "w_first", "yaw_of"]

_EPS = 1e-12


def _scipy(quaternions: Array) -> tuple[Rotation, tuple[int, ...]]:
    q = np.asarray(quaternions, dtype=np.float64)
    return Rotation.from_quat(q.reshape(-1, 4), scalar_first=True), q.shape[:-1]


def w_first(turns: Rotation) -> Array:
    """[N, 4] quaternions of N rotations. scipy takes three times as long to bring w to the front."""
    last = turns.as_quat()
    return np.concatenate([last[:, 3:], last[:, :3]], axis=1)


def multiply(a: Array, b: Array) -> Array:
    """Hamilton product of [..., 4] quaternions: the rotation b, then a."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    first = aw * bw
    out = np.empty((*first.shape, 4))
    np.subtract(first - ax * bx - ay * by, az * bz, out=out[..., 0])
    np.subtract(aw * bx + ax * bw + ay * bz, az * by, out=out[..., 1])
    np.add(aw * by - ax * bz + ay * bw, az * bx, out=out[..., 2])
    np.add(aw * bz + ax * by - ay * bx, az * bw, out=out[..., 3])
    return out


def conjugate(q: Array) -> Array:
    """The inverse of unit quaternions [..., 4]."""
    return np.asarray(q, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: Array, v: Array) -> Array:
    """Rotate vectors [..., 3] by unit quaternions [..., 4] (the leading shapes broadcast)."""
    w, u = q[..., :1], q[..., 1:]
    # v + 2 w (u x v) + 2 u x (u x v): two cross products in place of two quaternion products.
    t = 2.0 * cross(u, v)
    return v + w * t + cross(u, t)


def cross(a: Array, b: Array) -> Array:
    """[..., 3] as `np.cross`, bit for bit; that one takes five times as long for few vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    first = ay * bz
    out = np.empty((*first.shape, 3), first.dtype)
    np.subtract(first, az * by, out=out[..., 0])
    np.subtract(az * bx, ax * bz, out=out[..., 1])
    np.subtract(ax * by, ay * bx, out=out[..., 2])
    return out


def normalise(q: Array) -> Array:
    """Unit quaternions; a zero becomes the identity."""
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    identity = np.zeros_like(q)
    identity[..., 0] = 1.0
    return np.where(length > _EPS, q / np.maximum(length, _EPS), identity)


def continuous(q: Array) -> Array:
    """Choose the signs of quaternions [T, ..., 4] so that neighbours in time lie on the same half sphere."""
    # A flip of sign carries over to all later frames, hence the cumulative product.
    dots = np.sum(q[1:] * q[:-1], axis=-1)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([q[:1], q[1:] * signs[..., None]])


def from_euler(angles: Array, order: str) -> Array:
    """[..., 3] radians about the axes of `order` (such as "ZXY", the outermost first) to [..., 4]."""
    a = np.asarray(angles, dtype=np.float64)
    return Rotation.from_euler(order.upper(), a.reshape(-1, 3)).as_quat(scalar_first=True).reshape(*a.shape[:-1], 4)


def to_euler(q: Array, order: str) -> Array:
    """[..., 4] to [..., 3] radians about the axes of `order`; the inverse of `from_euler` as a rotation."""
    r, shape = _scipy(q)
    with np.errstate(all="ignore"):
        return r.as_euler(order.upper(), suppress_warnings=True).reshape(*shape, 3)


def from_exponential_map(v: Array) -> Array:
    """Exponential map [..., 3] (axis times angle, radians, any number of turns) to [..., 4]."""
    a = np.asarray(v, dtype=np.float64)
    return w_first(Rotation.from_rotvec(a.reshape(-1, 3))).reshape(*a.shape[:-1], 4)


def to_matrix(q: Array) -> Array:
    """Unit quaternions [..., 4] to rotation matrices [..., 3, 3], whose columns are the turned axes. For few of them
    scipy takes five times as long."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    doubled_x, doubled_y, doubled_z = 2.0 * x, 2.0 * y, 2.0 * z
    out = np.empty((*w.shape, 3, 3))
    xx, yy, zz = doubled_x * x, doubled_y * y, doubled_z * z
    xy, xz, yz = doubled_x * y, doubled_x * z, doubled_y * z
    wx, wy, wz = doubled_x * w, doubled_y * w, doubled_z * w
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 1.0 - (yy + zz), xy - wz, xz + wy
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = xy + wz, 1.0 - (xx + zz), yz - wx
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = xz - wy, yz + wx, 1.0 - (xx + yy)
    return out


def to_exponential_map(q: Array) -> Array:
    """[..., 4] to the exponential map [..., 3] of the shorter way round (angle at most pi)."""
    r, shape = _scipy(q)
    return r.as_rotvec().reshape(*shape, 3)


def unroll(v: Array) -> Array:
    """Exponential maps [T, ..., 3] freed of jumps of 2 pi along time. A rotation is axis times (angle + 2 pi n) for
    every n; for each frame the value nearest to the previous frame is taken. The identity, whose axis is undefined,
    takes the previous axis."""
    out = np.array(v, dtype=np.float64)
    turn = 2.0 * np.pi
    for t in range(1, len(out)):
        angle = np.linalg.norm(out[t], axis=-1, keepdims=True)
        before = out[t - 1]
        before_angle = np.linalg.norm(before, axis=-1, keepdims=True)
        axis = np.where(angle > 1e-9, out[t] / np.maximum(angle, _EPS),
                        before / np.maximum(before_angle, _EPS))
        # The previous value along this axis: the number of whole turns that comes nearest to it.
        along = np.sum(before * axis, axis=-1, keepdims=True)
        out[t] = axis * (angle + turn * np.round((along - angle) / turn))
    return out


def yaw_of(q: Array, axis: int = 1) -> Array:
    """The twist of [..., 4] about a coordinate axis (by default Y), as unit quaternions [..., 4]."""
    twist = np.zeros_like(q)
    twist[..., 0] = q[..., 0]
    twist[..., 1 + axis] = q[..., 1 + axis]
    return normalise(twist)


def remove_yaw(q: Array) -> Array:
    """The swing of [..., 4]: the rotation without its yaw, which is removed on the left."""
    # q = yaw * rest with yaw the twist of q about Y; then the twist of `rest` about Y is the identity.
    return multiply(conjugate(yaw_of(q)), q)


def between(a: Array, b: Array) -> Array:
    """[4] the shortest rotation from the direction a [3] to the direction b [3]."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    cosine = float(np.clip(a @ b, -1.0, 1.0))
    # Opposite directions have no shortest rotation: half a turn about any axis perpendicular to them.
    if cosine < -1.0 + 1e-9:
        normal = np.cross(a, [1.0, 0.0, 0.0] if abs(a[0]) < 0.9 else [0.0, 1.0, 0.0])
        return np.concatenate([[0.0], normal / np.linalg.norm(normal)])
    # For an angle t about n, (1 + cos t, n sin t) is the quaternion (cos t/2, n sin t/2) up to its length.
    return normalise(np.concatenate([[1.0 + cosine], np.cross(a, b)]))


def angle_between(a: Array, b: Array) -> Array:
    """Angle in radians, [...], between rotations [..., 4]."""
    relative = multiply(conjugate(a), b)
    # arctan2 stays accurate for tiny angles, where arccos of w loses half of its digits.
    return 2.0 * np.arctan2(np.linalg.norm(relative[..., 1:], axis=-1), np.abs(relative[..., 0]))


def interpolate(q: Array, positions: Array) -> Array:
    """Spherical interpolation of [T, ..., 4] at fractional frame positions [M], clamped to the ends: [M, ..., 4]."""
    x = np.clip(np.asarray(positions, dtype=np.float64), 0, len(q) - 1)
    low = np.minimum(x.astype(int), max(len(q) - 2, 0))
    high = np.minimum(low + 1, len(q) - 1)
    share = (x - low).reshape(-1, *[1] * (q.ndim - 1))
    a, b = q[low], q[high]
    # q and -q are one rotation: take the sign with the shorter way.
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(cosine < 0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.sin(angle)
    # For nearly equal rotations interpolate linearly, to avoid 0 / 0.
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    wa = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
    wb = np.where(near, share, np.sin(share * angle) / safe)
    return normalise(wa * a + wb * b)
