"""Rotations in numpy: quaternions (w first), exponential maps, matrices and Euler angles; continuity over time, the
removal of yaw, and interpolation.

Conversions agree with `scipy.spatial.transform.Rotation`, whose import takes four times as long as numpy's.
"""

import numpy as np

from data_module.types import Array

__all__ = ["angle_between", "between", "conjugate", "continuous", "cross", "from_axes", "from_euler",
           "from_exponential_map", "from_matrix", "interpolate", "mean", "multiply", "normalise", "partway",
           "remove_yaw", "rotate", "to_euler", "to_exponential_map", "to_matrix", "yaw_of"]

_EPS = 1e-12
_DIAGONAL = np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
"""4 w^2, 4 x^2, 4 y^2 and 4 z^2 are 1 plus the diagonal of the matrix times these."""
_POLE = 1e-7
"""Radians from a pole within which the first and the third Euler angle turn about one axis."""


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
    dots = np.einsum("...i,...i->...", q[1:], q[:-1])
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([q[:1], q[1:] * signs[..., None]])


def from_euler(angles: Array, order: str) -> Array:
    """[..., N] radians about the N axes of `order` (such as "ZXY", the outermost first) to [..., 4]."""
    half = 0.5 * np.asarray(angles, dtype=np.float64)
    turns = np.zeros((*half.shape, 4))
    turns[..., 0] = np.cos(half)
    for place, axis in enumerate(order.upper()):
        turns[..., place, 1 + "XYZ".index(axis)] = np.sin(half[..., place])
    out = turns[..., 0, :]
    for place in range(1, len(order)):
        out = multiply(out, turns[..., place, :])
    return out


def to_euler(q: Array, order: str) -> Array:
    """[..., 4] to [..., 3] radians about the three axes of `order`, in [-pi, pi); the inverse of `from_euler` as a
    rotation. Where the middle axis brings the others together, the third angle is 0."""
    first, middle, third = ("XYZ".index(axis) for axis in order.upper())
    # An odd order of axes is the mirror image of an even one.
    hand = (first - middle) * (middle - third) * (third - first) // 2
    w, vector = q[..., 0], hand * q[..., 1:]
    x, y, z = vector[..., first], vector[..., middle], vector[..., third]
    # With a = angle / 2: w + y and x + z are (cos b + sin b) (cos, sin)(a + c), and
    # w - y and x - z are (cos b - sin b) (cos, sin)(a - c).
    added, apart = np.arctan2(x + z, w + y), np.arctan2(x - z, w - y)
    rise = 2.0 * np.arctan2(np.hypot(x + z, w + y), np.hypot(x - z, w - y))
    low, high = rise <= _POLE, rise >= np.pi - _POLE
    out = np.stack([np.where(low, 2.0 * apart, np.where(high, 2.0 * added, added + apart)), rise - 0.5 * np.pi,
                    np.where(low | high, 0.0, added - apart)], axis=-1)
    return (hand * out + np.pi) % (2.0 * np.pi) - np.pi


def from_exponential_map(v: Array) -> Array:
    """Exponential map [..., 3] (axis times angle, radians, any number of turns) to [..., 4]."""
    v = np.asarray(v, dtype=np.float64)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    # Number by number: a sum over the last axis, which is short, takes most of the time.
    angle = np.sqrt(x * x + y * y + z * z)
    share = np.where(angle > 0.0, np.sin(0.5 * angle) / np.where(angle > 0.0, angle, 1.0), 0.5)
    out = np.empty((*angle.shape, 4))
    np.cos(0.5 * angle, out=out[..., 0])
    np.multiply(share[..., None], v, out=out[..., 1:])
    return out


def from_matrix(matrices: Array) -> Array:
    """Matrices [..., 3, 3] to the rotations [..., 4] nearest to them; `ValueError` for a reflection or a flat one."""
    m = np.asarray(matrices, dtype=np.float64)
    if np.any(np.sum(cross(m[..., 0, :], m[..., 1, :]) * m[..., 2, :], axis=-1) <= 0.0):
        raise ValueError("a reflection or a flat matrix is no rotation")
    sheared = np.abs(m @ np.swapaxes(m, -1, -2) - np.eye(3)).max(axis=(-2, -1)) > _EPS
    if np.any(sheared):
        left, _, right = np.linalg.svd(m)
        m = np.where(sheared[..., None, None], left @ right, m)
    # The matrix 4 q q^T; its row with the largest diagonal element loses nothing to rounding.
    out, turned = np.empty((*m.shape[:-2], 4, 4)), np.swapaxes(m, -1, -2)
    out[..., 1:, 1:] = m + turned
    out[..., 0, 1:] = out[..., 1:, 0] = (m - turned)[..., [2, 0, 1], [1, 2, 0]]
    out[..., range(4), range(4)] = diagonal = 1.0 + np.diagonal(m, axis1=-2, axis2=-1) @ _DIAGONAL
    # Of equal ones w comes last, as in scipy.
    largest = (diagonal[..., [1, 2, 3, 0]].argmax(axis=-1) + 1) % 4
    best = np.take_along_axis(out, largest[..., None, None], axis=-2)[..., 0, :]
    return best / np.linalg.norm(best, axis=-1, keepdims=True)


def from_axes(rest: tuple[Array, Array], first: Array, second: Array) -> Array:
    """[..., 4] rotations from two orthogonal unit vectors `rest`, [3] each, to `first` and `second`, [..., 3] each."""
    before = np.stack([*rest, np.cross(*rest)], axis=-1)
    return from_matrix(np.stack([first, second, np.cross(first, second)], axis=-1) @ before.T)


def mean(q: Array) -> Array:
    """[4] the mean of rotations [N, 4]: the one with the least squared distance to them as matrices."""
    return np.linalg.eigh(q.T @ q)[1][:, -1]


def to_matrix(q: Array) -> Array:
    """Unit quaternions [..., 4] to rotation matrices [..., 3, 3], whose columns are the turned axes."""
    q = np.asarray(q, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
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
    """[..., 4] of any length to the exponential map [..., 3] of the shorter way round (angle at most pi)."""
    q = np.asarray(q, dtype=np.float64)
    # Of q and -q the one whose first part that is not 0 is positive, so that half a turn has one axis, too.
    sign = np.sign(q[..., 0])
    for part in (1, 2, 3):
        sign = np.where(sign == 0.0, np.sign(q[..., part]), sign)
    length = np.sqrt(np.sum(q[..., 1:] ** 2, axis=-1))
    half = np.arctan2(length, sign * q[..., 0])
    share = np.where(length > 0.0, half / np.where(length > 0.0, length, 1.0), 1.0)
    return (2.0 * sign * share)[..., None] * q[..., 1:]


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
        axis = np.where(angle > 1e-9, out[t] / np.maximum(angle, _EPS), before / np.maximum(before_angle, _EPS))
        # The previous value along this axis: the number of whole turns that comes nearest to it.
        along = np.sum(before * axis, axis=-1, keepdims=True)
        out[t] = axis * (angle + turn * np.round((along - angle) / turn))
    return out


def yaw_of(q: Array, axis: int = 1) -> Array:
    """The twist of [..., 4] about a coordinate axis (by default Y), as unit quaternions [..., 4]."""
    return normalise(np.where(np.isin(np.arange(4), (0, 1 + axis)), q, 0.0))


def remove_yaw(q: Array) -> Array:
    """The swing of [..., 4]: the rotation without its yaw, which is removed on the left."""
    # q = yaw * rest with yaw the twist of q about Y; then the twist of `rest` about Y is the identity.
    return multiply(conjugate(yaw_of(q)), q)


def between(a: Array, b: Array, otherwise: Array | None = None) -> Array:
    """[..., 4] the shortest rotations from directions a to b, [..., 3] each. Opposite ones have none: half a turn about
    `otherwise` [..., 3], or about any axis perpendicular to them."""
    a, b = (way / np.sqrt(np.vecdot(way, way))[..., None] for way in (a, b))
    if otherwise is None:
        otherwise = cross(a, np.where(np.abs(a[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    # For an angle t about n, (1 + cos t, n sin t) is the quaternion (cos t/2, n sin t/2) up to its length.
    height = 0.5 * np.sum((a + b) ** 2, axis=-1, keepdims=True)
    aside = np.where(height > 5e-15, cross(a, b), otherwise - np.sum(otherwise * a, axis=-1, keepdims=True) * a)
    return normalise(np.concatenate([np.where(height > 5e-15, height, 0.0), aside], axis=-1))


def angle_between(a: Array, b: Array) -> Array:
    """Angle in radians, [...], between rotations [..., 4]."""
    return np.asarray(np.linalg.norm(to_exponential_map(multiply(conjugate(a), b)), axis=-1))


def interpolate(q: Array, positions: Array) -> Array:
    """Spherical interpolation of [T, ..., 4] at fractional frame positions [M], clamped to the ends: [M, ..., 4]."""
    x = np.clip(np.asarray(positions, dtype=np.float64), 0, len(q) - 1)
    low = np.minimum(x.astype(int), max(len(q) - 2, 0))
    return partway(q[low], q[np.minimum(low + 1, len(q) - 1)], (x - low).reshape(-1, *[1] * (q.ndim - 1)))


def partway(a: Array, b: Array, share: Array | float) -> Array:
    """[..., 4] rotations a share [..., 1] of the shortest turn from `a` to `b` [..., 4]."""
    turn = to_exponential_map(multiply(conjugate(a), b))
    return multiply(a, from_exponential_map(share * turn))
