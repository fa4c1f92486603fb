"""A filter at the end of a live sensor: the one object with a state."""

import io
import zipfile
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled
from sigmax.errors import InputError, unknown
from sigmax.filters import Filter
from sigmax.models.checks import finite, numbers
from sigmax.models.evaluate import noise_root
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model, noise
from sigmax.running.edge import as_filter, cast, start_factor
from sigmax.running.result import batch_first
from sigmax.running.step import Belief, Fault, Innovation, begin, correct, predict


class Live:
    """Predict and update step by step, for one track or for a batch of them in step.

    Args:
        filter: a name of the catalogue, or a filter.
        model: the model.
        prior: the state now, (n,) or (B, n).
        dtype: float64 or float32.

    The first predict and the first update of a model compile, some seconds; later ones take
    microseconds. A step that is not sound leaves the state as it was; `ok` and `fault` tell.

    Raises:
        InputError: for whatever does not fit.
    """

    def __init__(self, filter: Filter | str, model: Model, prior: Gaussian, *, dtype: Any = "float64") -> None:
        self.filter = as_filter(filter)
        if prior.size != model.size:
            raise InputError(f"the prior has {prior.size} components, the model {model.size}: {list(model.state)}")
        self._dtype = jnp.dtype(dtype)
        self._batched = prior.mean.ndim == 2
        self.model = cast(model, self._dtype)
        mean = jnp.asarray(prior.mean, self._dtype)
        cov = jnp.asarray(np.broadcast_to(prior.cov, (*mean.shape, model.size)), self._dtype)
        factor = start_factor(self.filter, jnp.moveaxis(cov, 0, -1) if self._batched else cov)
        self._belief = begin(self.filter, mean.T if self._batched else mean, factor)
        self._fault: Any = jnp.zeros(self._belief.mean.shape[1:], jnp.int8)
        # Flattened once: the model is the same in every call, and walking it would cost more than the step.
        self._leaves, structure = jax.tree.flatten(self.model)
        self._predict, self._update, self._step = _compiled(self.filter, structure)

    @property
    def mean(self) -> np.ndarray:
        """The estimate (n,) or (B, n)."""
        x = np.asarray(self._belief.mean)
        return x.T if self._batched else x

    @property
    def cov(self) -> np.ndarray:
        """Its covariance (n, n) or (B, n, n)."""
        S = np.asarray(self._belief.factor)
        S = np.moveaxis(S, -1, 0) if self._batched else S
        return S @ S.swapaxes(-1, -2)

    @property
    def std(self) -> np.ndarray:
        """Its standard deviations (n,) or (B, n)."""
        S = np.asarray(self._belief.factor)
        return np.sqrt((S * S).sum(1)).T

    @property
    def ok(self) -> Any:
        """Whether the last call was sound: a bool, or one for each track."""
        return bool(self._fault == 0) if not self._batched else np.asarray(self._fault) == 0

    @property
    def fault(self) -> Any:
        """Why it was not: a `Fault`, or a list of one for each track."""
        return [Fault(int(f)) for f in self._fault] if self._batched else Fault(int(self._fault))

    def predict(self, dt: float, u: Any = None) -> None:
        """Move the state dt seconds on, with inputs u (k,) where the motion takes them."""
        self._belief, self._fault = self._predict(
            self._leaves, self._belief, self._seconds(dt), self._inputs(u, "motion")
        )

    def update(self, z: Any, sensor: str | None = None, *, R: Any = None, u: Any = None) -> Innovation:
        """Correct with a measurement z (m,) or (B, m), NaN where a component is missing.

        Args:
            z: the measurement.
            sensor: which of the model's sensors it comes from, where there are several.
            R: its covariance or variances this time, if not the model's.
            u: inputs (k,) where the sensor takes them.

        Returns:
            Residual, factor of its covariance, NIS and log-likelihood.
        """
        name, value = self._measurement(z, sensor)
        used = self._noise(name, R)
        out = self._update(self._leaves, self._belief, name, value, used, self._inputs(u, "sensor", name))
        self._belief, told, self._fault = out
        return self._told(told)

    def expect(self, sensor: str | None = None, *, R: Any = None, u: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """What a sensor should measure now, (m,) or (B, m), and the covariance of the innovation: for gates."""
        name = self._sensor(sensor)
        names = self.model.measurement[name]
        if names is None:
            raise InputError(
                "name the components of the measurement in the model: R is a function and does not count them"
            )
        nothing = np.zeros((len(names), *self._belief.mean.shape[1:]), self._dtype)
        used = self._noise(name, R)
        _, told, _ = self._update(self._leaves, self._belief, name, nothing, used, self._inputs(u, "sensor", name))
        told = self._told(told)
        S = np.asarray(told.factor)
        return -np.asarray(told.residual), S @ S.swapaxes(-1, -2)

    def step(self, z: Any, dt: float, sensor: str | None = None, *, R: Any = None, u: Any = None) -> Innovation:
        """`predict(dt)` and `update(z)` in one compiled call."""
        name, value = self._measurement(z, sensor)
        used = self._noise(name, R)
        inputs = self._inputs(u, "motion", name)
        out = self._step(self._leaves, self._belief, name, self._seconds(dt), value, used, inputs)
        self._belief, told, self._fault = out
        return self._told(told)

    def save(self) -> bytes:
        """The state as bytes; `restore` gives it back bit for bit, in another process too."""
        buffer = io.BytesIO()
        leaves = jax.tree.leaves(self._belief)
        np.savez(buffer, *[np.asarray(a) for a in leaves], fault=np.asarray(self._fault))
        return buffer.getvalue()

    def restore(self, saved: bytes) -> None:
        """Take up a state that `save` gave, of the same filter, model and batch.

        Raises:
            InputError: where the bytes are no such state.
        """
        leaves, structure = jax.tree.flatten(self._belief)
        try:
            with np.load(io.BytesIO(saved), allow_pickle=False) as stored:
                found = [stored[f"arr_{i}"] for i in range(len(stored.files) - 1)]
                fault = stored["fault"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(f"these {len(saved)} bytes are no saved state: {error}") from error
        have, want = ([(a.shape, str(a.dtype)) for a in arrays] for arrays in (found, leaves))
        if have != want:
            raise InputError(f"the saved state has arrays {have}, this filter needs {want}")
        self._belief = jax.tree.unflatten(structure, [jnp.asarray(a) for a in found])
        self._fault = jnp.asarray(fault)

    def _cast(self, value: Any) -> np.ndarray:
        return np.asarray(value, self._dtype)

    def _seconds(self, dt: float) -> np.ndarray:
        if not dt >= 0:
            raise InputError(f"dt must be a number of seconds, not negative; it is {dt}")
        return self._cast(dt)

    def _told(self, told: Innovation) -> Innovation:
        return Innovation(*map(batch_first, told)) if self._batched else told

    def _sensor(self, sensor: str | None) -> str:
        if sensor is None and self.model.several:
            raise InputError(f"say which sensor measured: update(z, sensor=…), one of {sorted(self.model.sensors)}")
        if sensor is not None and sensor not in self.model.sensors:
            raise unknown("sensor", sensor, self.model.sensors)
        return sensor or ""

    def _measurement(self, z: Any, sensor: str | None) -> tuple[str, np.ndarray]:
        sensor = self._sensor(sensor)
        value = self._cast(z)
        names = self.model.measurement[sensor]
        wanted = (len(self.mean),) if self._batched else ()
        if (
            value.ndim != 1 + self._batched
            or value.shape[:-1] != wanted
            or (names is not None and value.shape[-1] != len(names))
        ):
            expected = (*wanted, len(names)) if names is not None else (*wanted, "m")
            raise InputError(
                f"z must have the shape {expected}{f' for {list(names)}' if names else ''}; it has {value.shape}"
            )
        return sensor, value.T if self._batched else value

    def _noise(self, sensor: str, R: Any) -> Any:
        if R is None:
            return self.model.R[sensor]
        return cast(noise("R", R, self.model.measurement[sensor]), self._dtype)

    def _inputs(self, u: Any, what: str, sensor: str | None = None) -> Any:
        wanted = self.model.motion_inputs if what == "motion" else False
        wanted = wanted or (sensor is not None and self.model.sensor_inputs[sensor])
        if not wanted:
            return None
        if u is None:
            raise InputError(f"the {what} takes inputs; give u=")
        value = numbers("u", u)
        finite("u", value)
        value = self._cast(value)
        return value.T if value.ndim == 2 else value


@lru_cache(maxsize=128)
def _compiled(filter: Filter, structure: Any) -> tuple[Any, Any, Any]:
    """The compiled half-steps and the whole step of a filter on models of one structure."""

    def move(leaves: Any, belief: Belief, dt: Any, u: Any) -> tuple[Belief, Any]:
        model = jax.tree.unflatten(structure, leaves)
        return predict(filter, model, noise_root(model.Q), belief, dt, u)

    def see(leaves: Any, belief: Belief, sensor: str, z: Any, R: Any, u: Any) -> tuple[Belief, Innovation, Any]:
        return correct(filter, jax.tree.unflatten(structure, leaves), sensor, R, belief, z, u)

    def both(
        leaves: Any, belief: Belief, sensor: str, dt: Any, z: Any, R: Any, u: Any
    ) -> tuple[Belief, Innovation, Any]:
        moved, fault = move(leaves, belief, dt, u)
        belief, told, failed = see(leaves, moved, sensor, jnp.where(fault == 0, z, jnp.nan), R, u)
        return belief, told, jnp.where(fault == 0, failed, fault)

    return compiled(move), compiled(see, static=(2,)), compiled(both, static=(2,))
