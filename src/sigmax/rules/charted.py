"""Rules on curved spaces: a rule sees numbers, and a chart stands between them and the points of a space."""

from typing import Any

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import Lifted
from sigmax.rules.linearization import Linearization, Rule
from sigmax.spaces import Space


def linearized(rule: Rule, g: Lifted, x: jax.Array, S: jax.Array, of: Space, to: Space) -> Linearization:
    """The line of g about N(x ⊞ S ξ), from points of one space to points of another.

    Flat parts are their own coordinates, curved ones are differences from a base: from x̂ and from g(x̂). Where both
    spaces are flat the rule is called as it is. Slope, residual and deficit belong to the tangent at ŷ.
    """
    if of.flat and to.flat:
        return rule(g, x, S, to.periodic)
    about = g(x)

    def through(c: jax.Array, base: jax.Array, onto: jax.Array, *rest: jax.Array) -> Any:
        return to.chart(onto, jnp.asarray(g.function(of.point(base, c), *rest)))

    # As arguments, so that what depends on the state is told from what only stands there.
    chart = Lifted(through, [(x, 1), (about, 1), *g.arguments], g.batched)
    line = rule(chart, coordinates(of, x), S, to.periodic)
    shift = to.shift(line.mean)
    turned = (to.turned(about, shift, M) if M.shape[1] else M for M in line[1:])
    return Linearization(to.point(about, line.mean), *turned)


def coordinates(space: Space, x: jax.Array) -> jax.Array:
    """The coordinates (dim, ...) of a point (size, ...) about itself: 0 of curved parts."""
    if space.flat:
        return x
    zero = jnp.zeros_like(x[:1])
    return jnp.concatenate([x[at] if p.flat else jnp.repeat(zero, p.dim, 0) for p, at, _ in space.parts()])
