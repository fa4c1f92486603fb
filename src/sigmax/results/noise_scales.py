"""What a filter has found of noises, in a result and live."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import is_traced
from sigmax.preparation.layout import Layout


class NoiseScales:
    """Numbers by which a filter with adaptive noises multiplies the variances of the model's R and Q."""

    layout: Layout

    def known_noises(self) -> Any:
        """What is known of noises (…, k), see `Noises`; None where the model's are taken."""
        raise NotImplementedError

    @property
    def R_scale(self) -> Any:
        """What a filter with `update="adaptive"` multiplies the variances of R by (…, T, m), live (m,) or (B, m).

        A dict by sensor where the model has several. Of a correlated R those of its whitened components. Smoothed
        estimates have what the filter knew.

        Raises:
            InputError: where R is the model's, or "modes", which holds the numbers, was not kept.
        """
        noises, known = self.layout.noises, self.known_noises()
        if not noises.sensors:
            raise InputError('R is that of the model here: see update="adaptive"')
        found = {sensor: known[..., a:b] for sensor, a, b in noises.sensors}
        return found if self.layout.several else next(iter(found.values()))

    @property
    def Q_scale(self) -> Any:
        """What a filter with `Q="adaptive"` multiplies the variances of Q by (…, T, K), a number for each group.

        Raises:
            InputError: where Q is the model's, or "modes", which holds the numbers, was not kept.
        """
        noises, known = self.layout.noises, self.known_noises()
        if not noises.groups:
            raise InputError('Q is that of the model here: see Q="adaptive" of sigmax.get')
        array: Any = jnp if is_traced(known) else np
        return array.exp(known[..., np.array(noises.logarithms)])
