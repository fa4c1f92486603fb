"""Turns and poses: x ⊞ δ = x · Exp(δ), differences in the axes of the body."""

from dataclasses import dataclass
from typing import Any

from sigmax.spaces.quaternions import (
    conjugate,
    cross,
    exponential,
    left,
    left_back,
    logarithm,
    multiply,
    of_unit_length,
    rotate,
    squared,
    stumpff,
)
from sigmax.spaces.space import Flat, Space, arrays

_CIRCLE = Flat((True,))


@dataclass(frozen=True)
class Rotation(Space):
    """SO(3): a unit quaternion w, x, y, z, of which −q is the same turn."""

    numbers = ("w", "x", "y", "z")
    deviations = ("roll", "pitch", "yaw")
    turns = 3

    def add(self, x: Any, delta: Any) -> Any:
        """Q exp(δ)."""
        return of_unit_length(multiply(x, exponential(delta)))

    def difference(self, a: Any, b: Any) -> Any:
        """log(b⁻¹ a), no longer than π."""
        return logarithm(multiply(conjugate(b), a))

    def turned(self, x: Any, delta: Any, M: Any) -> Any:
        """J_r(δ) M, J_r(δ) = J_l(−δ)."""
        return left(-delta[:, None], M)

    def turned_back(self, x: Any, delta: Any, M: Any) -> Any:
        """J_r(δ)⁻¹ M."""
        return left_back(-delta[:, None], M)

    def nearest(self, x: Any) -> Any:
        """Q / |q|."""
        return x / squared(x) ** 0.5


@dataclass(frozen=True)
class Pose3(Space):
    """SE(3): attitude and position; with velocity SE₂(3): attitude, velocity and position.

    Of a group element (R, v, p) the difference is a turn and, in the axes of the body, velocity and position:
    R exp(δ_R), v + R J_l(δ_R) δ_v, p + R J_l(δ_R) δ_p (Brossard, Barrau, Chauchat and Bonnabel, Associating uncertainty
    to extended poses for on Lie group IMU preintegration with rotating Earth, section III).

    Attributes:
        velocity: whether there is one.
    """

    velocity: bool = False
    turns = 3

    @property
    def _vectors(self) -> tuple[str, ...]:
        return (*(("vx", "vy", "vz") if self.velocity else ()), "x", "y", "z")

    @property
    def numbers(self) -> tuple[str, ...]:  # type: ignore[override]
        """A quaternion and vectors in the axes of the world."""
        return ("qw", "qx", "qy", "qz", *self._vectors)

    @property
    def deviations(self) -> tuple[str, ...]:  # type: ignore[override]
        """A turn and vectors in the axes of the body."""
        return ("roll", "pitch", "yaw", *self._vectors)

    def _places(self) -> list[tuple[slice, slice]]:
        """Where each vector stands in a point and in a difference."""
        return [(slice(k + 1, k + 4), slice(k, k + 3)) for k in range(3, self.dim, 3)]

    def add(self, x: Any, delta: Any) -> Any:
        """The pose x · Exp(δ)."""
        q, d = x[:4], delta[:3]
        moved = [x[a] + rotate(q, left(d, delta[t])) for a, t in self._places()]
        return arrays(x, delta).concatenate([of_unit_length(multiply(q, exponential(d))), *moved])

    def difference(self, a: Any, b: Any) -> Any:
        """Log(b⁻¹ a)."""
        back = conjugate(b[:4])
        d = logarithm(multiply(back, a[:4]))
        return arrays(a, b).concatenate([d, *(left_back(d, rotate(back, a[s] - b[s])) for s, _ in self._places())])

    def turned(self, x: Any, delta: Any, M: Any) -> Any:
        """J_r(δ) M, J_r = [[J_r, 0], [Q, J_r]] for each vector."""
        d, turn = -delta[:3, None], M[:3]
        rows = [_beside(d, -delta[t, None], turn) + left(d, M[t]) for _, t in self._places()]
        return arrays(delta, M).concatenate([left(d, turn), *rows])

    def turned_back(self, x: Any, delta: Any, M: Any) -> Any:
        """J_r(δ)⁻¹ M."""
        d = -delta[:3, None]
        turn = left_back(d, M[:3])
        rows = [left_back(d, M[t] - _beside(d, -delta[t, None], turn)) for _, t in self._places()]
        return arrays(delta, M).concatenate([turn, *rows])

    def nearest(self, x: Any) -> Any:
        """The quaternion q / |q|, the vectors as they are."""
        return arrays(x).concatenate([x[:4] / squared(x[:4]) ** 0.5, x[4:]])


def _beside(d: Any, r: Any, M: Any) -> Any:
    """Q_l(δ, ρ) M, the block of the left Jacobian of SE(3) below that of SO(3) (Barfoot, (7.86))."""
    c = stumpff(squared(d))
    rM, dM = cross(r, M), cross(d, M)
    d_rM, r_dM, d_dM = cross(d, rM), cross(r, dM), cross(d, dM)
    d_r_dM, r_d_dM = cross(d, r_dM), cross(r, d_dM)
    cubic = c[4] * (cross(d, d_rM) + r_d_dM - 3.0 * d_r_dM)
    quartic = 0.5 * (c[4] - 3.0 * c[5]) * (cross(d, r_d_dM) + cross(d, d_r_dM))
    return 0.5 * rM + c[3] * (d_rM + r_dM + d_r_dM) + cubic + quartic


@dataclass(frozen=True)
class Pose2(Space):
    """SE(2): heading and position; a difference is a turn and, in the axes of the body, a position."""

    numbers = ("heading", "x", "y")
    deviations = ("heading", "x", "y")
    turns = 1

    def add(self, x: Any, delta: Any) -> Any:
        """The pose x · Exp(δ)."""
        moved = x[1:] + _turn(x[0], _twist(delta[0], delta[1:]))
        return arrays(x, delta).concatenate([_CIRCLE.add(x[:1], delta[:1]), moved])

    def difference(self, a: Any, b: Any) -> Any:
        """Log(b⁻¹ a)."""
        d = _CIRCLE.difference(a[:1], b[:1])
        c = stumpff(0.25 * d[0] * d[0])
        p, half, along = _turn(-b[0], a[1:] - b[1:]), 0.5 * d[0], c[0] / c[1]
        return arrays(a, b).stack([d[0], along * p[0] + half * p[1], along * p[1] - half * p[0]])

    def turned(self, x: Any, delta: Any, M: Any) -> Any:
        """J_r(δ) M (Solà, Deray and Atchuthan, A micro Lie theory, (163))."""
        d, (px, py) = delta[0], delta[1:]
        c = stumpff(d * d)
        beside = [d * c[3] * px - c[2] * py, c[2] * px + d * c[3] * py]
        moved = _twist(-d, M[1:])
        return arrays(delta, M).stack([M[0], moved[0] + beside[0] * M[0], moved[1] + beside[1] * M[0]])


def _turn(angle: Any, v: Any) -> Any:
    """The vector v (2, ...) turned by an angle (...)."""
    xp = arrays(angle, v)
    c, s = xp.cos(angle), xp.sin(angle)
    return xp.stack([c * v[0] - s * v[1], s * v[0] + c * v[1]])


def _twist(angle: Any, v: Any) -> Any:
    """Where one goes that walks v (2, ...) while turning by an angle (...)."""
    c = stumpff(angle * angle)
    return arrays(angle, v).stack([c[1] * v[0] - angle * c[2] * v[1], angle * c[2] * v[0] + c[1] * v[1]])
