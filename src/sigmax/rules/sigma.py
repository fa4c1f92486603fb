"""Sigma-point rules: statistical linear regression over any sigma set, of what is not linear alone."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import Lifted, wrap
from sigmax.algebra.factor import reflected, turned_back
from sigmax.dependence import Plan, Reading, planned, reading
from sigmax.dependence.line import grouped
from sigmax.dependence.reads import components
from sigmax.rules.linearization import Function, Linearization, slope_of
from sigmax.rules.regression import regressed
from sigmax.rules.sets import Family, unit_counts, unit_set
from sigmax.rules.sigma_set import SigmaSet


class SigmaPoints:
    """A rule made from a family of sigma sets, a function `family(n, **parameters)`.

    Of a model's function it samples only what is not a straight line of the state, each part at its
    distinct points; what is linear has its exact moments. Two rules of the same family and parameters
    are equal, so a compiled filter is found again.

    Args:
        family: makes the set.
        permute: draw the points in the order of the state in which a function is evaluated least, where
            that pays. The points then come from another root of the same covariance: equally good, but
            not the same numbers for a function that is not linear (Belov et al.).
        parameters: of the family.
    """

    def __init__(self, family: Family, *, permute: bool = False, **parameters: Any) -> None:
        self.family, self.permute = family, permute
        self.parameters = tuple(sorted(parameters.items()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SigmaPoints) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        said = [f"{k}={v!r}" for k, v in self.parameters] + (["permute=True"] if self.permute else [])
        return f"SigmaPoints({', '.join([self.family.__name__, *said])})"

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.family, self.permute, self.parameters

    def points(self, n: int) -> SigmaSet:
        """The unit set in n dimensions."""
        return unit_set(self.family, self.parameters, n)

    def plan(self, read: Reading, angular: Sequence[bool], columns: int | None = None) -> Plan:
        """What is done with a function of which it is known what it reads, over so many columns of the factor."""
        n = read.size if columns is None else columns
        return planned(read, angular, *unit_counts(self.family, self.parameters, n), self.permute)

    def evaluations(self, g: Function, n: int, angular: Sequence[bool], columns: int | None = None) -> int:
        """How often g is evaluated about n components; derivatives in a direction count as one.

        Over so many columns of their factor, n if nothing is said.

        Of a function of a model, the most often evaluated part of what is sampled; one that is linear altogether
        is evaluated at the mean and along each column of the factor.
        """
        columns = n if columns is None else columns
        unit = self.points(columns)
        if not isinstance(g, Lifted):
            return unit.evaluations
        read = reading(g.function, n, g.single)
        plan = self.plan(read, angular, columns)
        if not plan.rows:
            return 1 + columns
        level = max(plan.level(part.reads) for part in plan.parts)
        at_mean = not unit.points[grouped(unit.points).first[level], :level].any(1).all()
        # Angles are differences about the value at the mean.
        return unit.counts[level] + (not at_mean and any(angular[i] for i in plan.rows))

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """Evaluate g at the points x̂ + S ξ and regress; angles are differences about a reference."""
        unit = self.points(S.shape[1])
        if not isinstance(g, Lifted):
            return regressed(unit, lambda points, _: g(points), x, S, angular)
        read = reading(g.function, x.shape[0], g.single, x.dtype)
        plan = self.plan(read, angular, S.shape[1])
        made: dict[int, Linearization] = {}
        linear = tuple(i for i in range(len(read.results)) if i not in plan.rows)
        if linear:
            made |= _rows(linear, _linear(read, linear, g, x, S, [angular[i] for i in linear]))
        if plan.rows:
            turning = [angular[i] for i in plan.rows]
            made |= _rows(plan.rows, _sampled(unit, plan, read, g, x, S, turning))
        return _joined([made[i] for i in range(len(read.results))])


def _linear(
    read: Reading, rows: Sequence[int], g: Lifted, x: jax.Array, S: jax.Array, angular: Sequence[bool]
) -> Linearization:
    """Results that are linear: their value at the mean, their slope along the factor, nothing missed."""
    y, slope = slope_of(g.instead(_chosen(read, rows, lambda carried: carried < 0)), x, S)
    return Linearization(wrap(y, angular), slope, slope[:, :0], slope[:, :0])


def _sampled(
    unit: SigmaSet, plan: Plan, read: Reading, g: Lifted, x: jax.Array, S: jax.Array, angular: Sequence[bool]
) -> Linearization:
    """Results that are nonlinear: sampled over the components that make them so, the others held at their mean.

    The components that vary are N(x_a, T Tᵀ), and a projected sigma set is one for them; S_a = T Θ with
    orthonormal rows Θ brings the slope back to the columns of S. What enters linearly adds its slope.
    """
    levels, whole = plan.places(read), len(plan.rows) == len(read.results)

    def at(points: jax.Array, xi: np.ndarray) -> jax.Array:
        groups = grouped(xi)

        def single(points: jax.Array, *rest: jax.Array) -> jax.Array:
            values = read.line.at_points(points, rest, levels, groups)
            return values if whole else values[np.array(plan.rows)]

        return g.over_batch(single, points)

    if plan.turned:
        root, mirrors = reflected(jnp.stack([S[c] for c in plan.order]))
        rows = dict(zip(plan.order, root, strict=True))
    else:
        rows = {c: S[c, : plan.size] for c in plan.order}
    nothing = jnp.zeros_like(rows[plan.order[0]])
    factor = jnp.stack([rows[c] if plan.levels[c] else nothing for c in range(read.size)])
    line = regressed(unit.projected(plan.size), at, x, factor, angular)
    if plan.turned:
        slope = turned_back(line.slope, mirrors)
    else:
        beyond = jnp.zeros((len(plan.rows), S.shape[1] - plan.size, *x.shape[1:]), x.dtype)
        slope = jnp.concatenate([line.slope, beyond], axis=1)
    held = 0
    for i in plan.rows:
        held |= read.masks[read.results[i].index].reads & ~read.nonlinear
    if held:
        along = jnp.stack([S[c] if c in components(held) else jnp.zeros_like(S[c]) for c in range(read.size)])
        slope = slope + slope_of(g.instead(_chosen(read, plan.rows, lambda carried: carried & held)), x, along)[1]
    return line._replace(slope=slope)


def _chosen(read: Reading, rows: Sequence[int], matters: Callable[[int], Any]) -> Any:
    """Some results of a function; derivatives pass where what a value carries linearly matters to them."""
    places = np.array(rows)
    stopped = frozenset(
        number
        for number, call in enumerate(read.line.calls)
        if all(read.places[o].reads and not matters(read.carries[o]) for o in call.outputs)
    )

    def function(x: jax.Array, *rest: jax.Array) -> jax.Array:
        values = read.line(x, *rest, stopped=stopped)
        return values if len(rows) == len(read.results) else values[places]

    return function


def _rows(places: Sequence[int], line: Linearization) -> dict[int, Linearization]:
    return {place: Linearization(*(part[i] for part in line)) for i, place in enumerate(places)}


def _joined(rows: Sequence[Linearization]) -> Linearization:
    """Linearisations of one result each as one; where a row misses nothing its columns are zero."""
    widths = [max(row[k].shape[0] for row in rows) for k in (2, 3)]

    def filled(columns: jax.Array, width: int) -> jax.Array:
        empty = jnp.zeros((width - columns.shape[0], *columns.shape[1:]), columns.dtype)
        return jnp.concatenate([columns, empty])

    return Linearization(
        jnp.stack([row.mean for row in rows]),
        jnp.stack([row.slope for row in rows]),
        jnp.stack([filled(row.residual, widths[0]) for row in rows]),
        jnp.stack([filled(row.deficit, widths[1]) for row in rows]),
    )
