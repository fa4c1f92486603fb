"""How tracks begin: from one plot, from two, or from one with many hypotheses of course and speed."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sigmax.errors import InputError
from sigmax.modelling.model import Model
from sigmax.modelling.parts import made_once
from sigmax.tracking.detector import Located


class Births(NamedTuple):
    """Tracks that begin, by position and velocity.

    Attributes:
        position: (k, d).
        velocity: (k, d).
        cov: of position and velocity (k, 2d, 2d).
        plot: the plot each was last seen by (k,).
        plots: how many plots each has had.
    """

    position: np.ndarray
    velocity: np.ndarray
    cov: np.ndarray
    plot: np.ndarray
    plots: int


class Free(NamedTuple):
    """Plots that belong to no track.

    Attributes:
        time: seconds.
        where: where they are.
        plot: their places in the scan (k,).
    """

    time: float
    where: Located
    plot: np.ndarray


# The plots that are free now, and what the rule gave to be remembered for this sensor (None at first)
# -> tracks that begin, and what is to be remembered.
Initiate = Callable[[Free, Any], tuple[Births, Any]]


@made_once
def single_plot(max_speed: float) -> Initiate:
    """Every free plot begins a track of unknown velocity: standard deviation max_speed / √3 an axis.

    A velocity, radial or whole, is taken in where there is one.
    """
    _positive("max_speed", max_speed)

    def initiate(free: Free, memory: Any) -> tuple[Births, Any]:
        k, d = free.where.position.shape
        cov = np.zeros((k, 2 * d, 2 * d))
        cov[:, :d, :d] = free.where.cov
        cov[:, d:, d:] = np.eye(d) * max_speed**2 / 3
        return with_velocity(Births(free.where.position, np.zeros((k, d)), cov, free.plot, 1), free.where), memory

    return initiate


@made_once
def two_point(max_speed: float, within: float) -> Initiate:
    """Two free plots of a sensor that a target of at most `max_speed` joins begin a track (Bar-Shalom, 5.5.3).

    Velocity by difference, its error fully correlated with the later position's; a radial velocity, where
    there is one, has to agree within four standard deviations, and is taken in.

    Args:
        max_speed: m/s; three standard deviations of the positions are granted beside it.
        within: seconds that the earlier plot may be old.
    """
    _positive("max_speed", max_speed)
    _positive("within", within)

    def initiate(free: Free, memory: Any) -> tuple[Births, Any]:
        earlier: list[Free] = [e for e in (memory or []) if 0 < free.time - e.time <= within]
        d = free.where.position.shape[1]
        found = []
        taken = np.zeros(len(free.plot), bool)
        rest = []
        # From the latest back: the shortest leg tells most surely which plots belong together.
        for old in reversed(earlier):
            dt = free.time - old.time
            new = np.flatnonzero(~taken)
            i, j = _joined(old.where, free.where.take(new), max_speed * dt)
            j = new[j]
            velocity = (free.where.position[j] - old.where.position[i]) / dt
            fits = _agrees(velocity, old.where.cov[i] / dt**2 + free.where.cov[j] / dt**2, free.where.take(j))
            i, j, velocity = i[fits], j[fits], velocity[fits]
            cov = np.zeros((len(j), 2 * d, 2 * d))
            C = free.where.cov[j]
            cov[:, :d, :d] = C
            cov[:, :d, d:] = cov[:, d:, :d] = C / dt
            cov[:, d:, d:] = (C + old.where.cov[i]) / dt**2
            born = Births(free.where.position[j], velocity, cov, free.plot[j], 2)
            found.append(with_velocity(born, free.where.take(j)))
            taken[j] = True
            left = np.ones(len(old.plot), bool)
            left[i] = False
            rest.append(Free(old.time, old.where.take(left), old.plot[left]))
        kept = ~taken
        rest = [*reversed(rest), Free(free.time, free.where.take(kept), free.plot[kept])]
        if not found:
            nothing = np.empty((0, d))
            return Births(nothing, nothing, np.empty((0, 2 * d, 2 * d)), np.empty(0, int), 2), rest
        position, velocity, cov, plot = (np.concatenate(part) for part in zip(*(b[:4] for b in found), strict=True))
        return Births(position, velocity, cov, plot, 2), rest

    return initiate


def _joined(old: Located, new: Located, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of plots within reach, each plot in one pair at most, the nearest first."""
    if not len(old.position) or not len(new.position):
        return np.empty(0, int), np.empty(0, int)
    spread = [3 * np.sqrt(np.einsum("kii->ki", w.cov).max(1)) for w in (old, new)]
    tree = cKDTree(old.position)
    near = tree.query_ball_point(new.position, reach + spread[1] + spread[0].max())
    j = np.repeat(np.arange(len(near)), [len(some) for some in near])
    i = np.fromiter((k for some in near for k in some), int, len(j))
    length = np.linalg.norm(new.position[j] - old.position[i], axis=1)
    fits = length <= reach + spread[1][j] + spread[0][i]
    order = np.argsort(length[fits], kind="stable")
    i, j = i[fits][order], j[fits][order]
    used_i, used_j, chosen = set(), set(), []
    for k, (a, b) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
        if a not in used_i and b not in used_j:
            used_i.add(a)
            used_j.add(b)
            chosen.append(k)
    return i[chosen], j[chosen]


def _agrees(velocity: np.ndarray, cov: np.ndarray, where: Located) -> np.ndarray:
    if where.radial is None or where.direction is None:
        return np.ones(len(velocity), bool)
    e = where.direction
    variance = np.einsum("ki,kij,kj->k", e, cov, e) + where.radial_variance
    miss = where.radial - (e * velocity).sum(1)
    return ~(miss**2 > 16 * variance)


def with_velocity(births: Births, where: Located) -> Births:
    """Births with what the plots tell of the velocity: all of it, or the part along the line of sight."""
    if where.velocity is not None and where.velocity_cov is not None:
        # Every component is the velocity along an axis.
        axes = np.eye(where.velocity.shape[1])
        if np.any(where.velocity_cov != np.diag(np.diag(where.velocity_cov))):
            raise InputError("a velocity that plots tell needs components with independent errors")
        for axis, told, variance in zip(axes, where.velocity.T, np.diag(where.velocity_cov), strict=True):
            along = Located(where.position, where.cov, np.tile(axis, (len(told), 1)), told, float(variance))
            births = with_velocity(births, along)
    if where.radial is None or where.direction is None or not len(births.plot):
        return births
    d = births.position.shape[1]
    e = where.direction
    heard = ~np.isnan(where.radial)
    cross = np.einsum("kij,kj->ki", births.cov[:, :, d:], e)
    variance = np.einsum("ki,ki->k", cross[:, d:], e) + where.radial_variance
    gain = np.where(heard[:, None], cross / variance[:, None], 0.0)
    miss = np.where(heard, where.radial - (e * births.velocity).sum(1), 0.0)
    moved = gain * miss[:, None]
    cov = births.cov - gain[:, :, None] * cross[:, None, :]
    return births._replace(
        position=births.position + moved[:, :d],
        velocity=births.velocity + moved[:, d:],
        cov=(cov + cov.swapaxes(1, 2)) / 2,
    )


class Layout(NamedTuple):
    """Where position and velocity stand in a state, and what the rest is at birth.

    Attributes:
        position: places of the position.
        velocity: places of the velocity; or
        polar_velocity: of speed and course.
        rest: (mean, standard deviation) of each other component, by name.
    """

    position: tuple[int, ...] = (0, 1)
    velocity: tuple[int, ...] | None = (2, 3)
    polar_velocity: tuple[int, int] | None = None
    rest: dict[str, tuple[float, float]] = {}  # noqa: RUF012

    def speed(self, mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Speeds of states (B,) and their standard deviations."""
        if self.velocity is None:
            assert self.polar_velocity is not None
            place = self.polar_velocity[0]
            return np.abs(mean[:, place]), np.sqrt(cov[:, place, place])
        speed = np.linalg.norm(mean[:, self.velocity], axis=1)
        along = self.course(mean)
        places = np.array(self.velocity)
        return speed, np.sqrt(np.einsum("ki,kij,kj->k", along, cov[:, places[:, None], places], along))

    def course(self, mean: np.ndarray) -> np.ndarray:
        """Unit vectors (B, d) along the velocities of states (B, n)."""
        if self.velocity is None:
            assert self.polar_velocity is not None
            angle = mean[:, self.polar_velocity[1]]
            return np.stack([np.cos(angle), np.sin(angle)], axis=1)
        v = mean[:, self.velocity]
        return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1), 1e-12)[:, None])

    def priors(self, births: Births, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Means (k, n) and covariances (k, n, n) of states."""
        k, n, d = len(births.plot), model.size, len(self.position)
        mean, cov = np.zeros((k, n)), np.zeros((k, n, n))
        places = [*self.position, *(self.velocity or self.polar_velocity or ())]
        for i, name in enumerate(model.state):
            if i not in places:
                if name not in self.rest:
                    raise InputError(f"layout.rest needs (mean, standard deviation) of {name!r} for new tracks")
                mean[:, i], cov[:, i, i] = self.rest[name][0], self.rest[name][1] ** 2
        both = births.cov
        velocity = births.velocity
        if self.velocity is None:
            velocity, J = _polar(velocity)
            whole = np.zeros((k, 2 * d, 2 * d))
            whole[:, :d, :d], whole[:, d:, d:] = np.eye(d), J
            both = whole @ both @ whole.swapaxes(1, 2)
            # The course of a target that may as well stand still is anywhere.
            over = np.pi**2 / 3 / np.maximum(both[:, -1, -1], 1e-300)
            shrink = np.ones((k, 2 * d))
            shrink[:, -1] = np.sqrt(np.minimum(over, 1.0))
            both = both * shrink[:, :, None] * shrink[:, None, :]
        mean[:, places] = np.concatenate([births.position, velocity], axis=1)
        cov[:, np.array(places)[:, None], places] = both
        return mean, cov


def _polar(velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed and course (k, 2) of velocities, and the derivatives (k, 2, 2)."""
    speed = np.linalg.norm(velocity, axis=1)
    safe = np.maximum(speed, 1e-3)
    c, s = np.where(speed > 0, velocity[:, 0] / safe, 1.0), velocity[:, 1] / safe
    J = np.stack([np.stack([c, s], 1), np.stack([-s / safe, c / safe], 1)], 1)
    return np.stack([speed, np.arctan2(velocity[:, 1], velocity[:, 0])], 1), J


def _positive(name: str, value: float) -> None:
    if not value > 0:
        raise InputError(f"{name} must be above 0; it is {value}")
