"""Marginal rules: where a function is linear in some components, points are needed in the others alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from sigmax.errors import InputError
from sigmax.rules.linearization import Function, Linearization, Rule
from sigmax.rules.sets import projected
from sigmax.rules.sigma import SigmaPoints


@dataclass(frozen=True, repr=False)
class Marginal:
    """A rule for functions g(x, b) = g(x) + G b of a state and a bias behind it: b is integrated exactly.

    With S = [[S_x, 0], [S_bx, S_b]] the state depends on the first n columns alone, so that the rule
    works on these and the columns of S_b are multiplied by G (Zhang et al., corrected: the regression
    matrix of the whole is [H, G]). An n-dimensional set takes the place of one of n + p dimensions.

    Attributes:
        rule: the rule in the dimensions of the state.
        exact: take, instead of the set of n dimensions, what the set of n + p dimensions leaves on the
            state: then the result is the one of `rule` itself in n + p dimensions.
        biases: p.
    """

    rule: Rule
    exact: bool = False
    biases: int = 0

    def __repr__(self) -> str:
        return f"Marginal({self.rule}{', exact' if self.exact else ''})"

    def on(self, biases: int) -> Rule:
        """The rule for so many biases, which without any is the rule itself.

        Raises:
            InputError: where `exact` is asked of a rule without points.
        """
        if not biases:
            return self.rule
        if not self.exact:
            return replace(self, biases=biases)
        if not isinstance(self.rule, SigmaPoints):
            raise InputError(f"only a sigma set can be projected, not {self.rule}")
        given = dict(self.rule.parameters, of=self.rule.family, biases=biases)
        return Marginal(SigmaPoints(projected, permute=self.rule.permute, **given), biases=biases)

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """Linearise g: (n + p, ..., B) -> (m, ..., B) in the columns of the state, and the bias as it is."""
        n = x.shape[0] - self.biases
        line = self.rule(g, x, S[:, :n], angular)
        _, along = jax.linearize(lambda b: g(jnp.concatenate([x[:n], b])), x[n:])
        beside = jax.vmap(along, in_axes=1, out_axes=1)(S[n:, n:])
        return line._replace(slope=jnp.concatenate([line.slope, beside], axis=1))
