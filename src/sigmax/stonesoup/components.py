"""A predictor and an updater on the base classes of Stone Soup, computed by a filter of sigmax."""

from collections.abc import Hashable
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from stonesoup.base import Base, Property
from stonesoup.models.measurement import MeasurementModel
from stonesoup.predictor.base import Predictor
from stonesoup.types.array import CovarianceMatrix, StateVector
from stonesoup.types.prediction import GaussianMeasurementPrediction, MeasurementPrediction, Prediction
from stonesoup.types.state import GaussianState, SqrtGaussianState, State, StateMutableSequence
from stonesoup.types.update import Update
from stonesoup.updater.base import Updater

from sigmax.engine.rows import RowSteps
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.modelling.checks import numbers, symmetric_semidefinite
from sigmax.models import Model, angle
from sigmax.preparation.prepare import as_filter
from sigmax.stonesoup.translate import Seen, motion_of, sensor_of


class SigmaxPredictor(Predictor):  # type: ignore[misc]
    """Predicts Gaussian states with the rule and form of a filter of sigmax.

    Takes the place of `ExtendedKalmanPredictor`, `UnscentedKalmanPredictor` and the like. The first prediction
    compiles, which takes some seconds.

    Raises:
        InputError: for a transition model without translation, a control model, or a step back in time.
    """

    filter: Any = Property(default="EKF", doc="A name of the catalogue, or a filter of sigmax.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.filter = as_filter(self.filter)
        if self.control_model is not None:
            raise InputError("a control model is not taken; put what is controlled into the transition model")
        self._made: tuple[Any, Any, RowSteps] | None = None

    def predict(self, prior: Any, timestamp: Any = None, **kwargs: Any) -> Any:
        """The state at `timestamp`; without one, or at the time of the prior, the state as it is."""
        # Predictions of a track are kept by the state it is in, which changes under the same track.
        inner = isinstance(prior, StateMutableSequence) and not isinstance(prior, State)
        return _predicted(self, prior.state if inner else prior, timestamp, _told(self.transition_model))

    def __getstate__(self) -> dict[str, Any]:
        # What is compiled is made anew where it is needed.
        return {**self.__dict__, "_made": None}

    @property
    def steps(self) -> RowSteps:
        """The compiled steps of the transition model as it is now."""
        return self._as_told(_told(self.transition_model))

    def _as_told(self, told: Any) -> RowSteps:
        if self._made is None or self._made[0] is not self.transition_model or self._made[1] != told:
            moved = motion_of(self.transition_model)
            n = moved.size
            # Nothing is ever seen through this sensor.
            model = Model(motion=moved.function, Q=moved.Q, sensor=_first, R=[1.0], state=_states(n))
            self._made = self.transition_model, told, RowSteps(self.filter, model)
        return self._made[2]


# As many as Stone Soup's own predictors keep.
@lru_cache(maxsize=128)
def _predicted(predictor: SigmaxPredictor, prior: Any, timestamp: Any, told: Any) -> Any:
    steps = predictor._as_told(told)
    timeless = timestamp is None or prior.timestamp is None
    seconds = 0.0 if timeless else (timestamp - prior.timestamp).total_seconds()
    if seconds < 0:
        raise InputError(f"predictions go forwards in time; {timestamp} is before {prior.timestamp}")
    rows, fault = steps.predict(_rows(steps, prior), seconds)
    if fault[0]:
        raise FloatingPointError(f"the prediction of {predictor.filter} to {timestamp} is not sound")
    made = Prediction.from_state(
        prior,
        *_moments(steps, rows, prior),
        timestamp=timestamp,
        transition_model=predictor.transition_model,
        prior=prior,
    )
    _remembered(steps, made, rows)
    return made


class SigmaxUpdater(Updater):  # type: ignore[misc]
    """Corrects Gaussian predictions with the rule and form of a filter of sigmax.

    Takes the place of `ExtendedKalmanUpdater`, `UnscentedKalmanUpdater` and the like, in hypothesisers, associators
    and initiators. Measurement models that differ only in numbers (where the sensor stands, its noise) share one
    compilation.

    Raises:
        InputError: for a measurement model without translation.
    """

    measurement_model: MeasurementModel = Property(default=None, doc="The model of detections that carry none.")
    filter: Any = Property(default="EKF", doc="A name of the catalogue, or a filter of sigmax.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.filter = as_filter(self.filter)

    def predict_measurement(
        self, predicted_state: Any, measurement_model: Any = None, measurement_noise: bool = True, **kwargs: Any
    ) -> Any:
        """What should be measured, its covariance, and its covariance with the state."""
        model = self._check_measurement_model(measurement_model)
        return _expected(self, predicted_state, model, _told(model), measurement_noise)

    def update(self, hypothesis: Any, **kwargs: Any) -> Any:
        """The state after the measurement of a hypothesis."""
        prediction, detection = hypothesis.prediction, hypothesis.measurement
        model = self._check_measurement_model(detection.measurement_model)
        if hypothesis.measurement_prediction is None:
            hypothesis.measurement_prediction = self.predict_measurement(prediction, model)
        steps, seen = _steps(self.filter, model, _told(model))
        z = np.asarray(numbers("a detection", detection.state_vector, missing=True), float).reshape(1, -1)
        if z.size != len(seen.R):
            raise InputError(f"the detection has {z.size} components, the measurement model {len(seen.R)}")
        rows, _, fault = steps.correct(_rows(steps, prediction), "", z, seen.u)
        if fault[0]:
            raise FloatingPointError(f"the correction of {self.filter} at {detection.timestamp} is not sound")
        moments = _moments(steps, rows, prediction)
        made = Update.from_state(prediction, *moments, timestamp=detection.timestamp, hypothesis=hypothesis)
        _remembered(steps, made, rows)
        return made


@lru_cache(maxsize=128)
def _expected(updater: SigmaxUpdater, predicted: Any, model: Any, told: Any, noisy: bool) -> Any:
    steps, seen = _steps(updater.filter, model, told)
    rows = _rows(steps, predicted)
    m, n = len(seen.R), seen.size
    _, told, fault = steps.correct(rows, "", np.zeros((1, m)), seen.u)
    if fault[0]:
        raise FloatingPointError(f"the measurement that {updater.filter} expects is not sound")
    expected, factor = -told.residual[0], told.factor[0]
    S = factor @ factor.T
    # The mean moves by K ν: one deviation in each component shows the columns of K.
    deviation = np.minimum(np.sqrt(np.diagonal(S)), [np.inf if a is None else 1.0 for a in seen.angles])
    shifted = [steps.correct(rows, "", z[None], seen.u)[0] for z in expected + np.diag(deviation)]
    gain = (steps.mean(np.concatenate(shifted)) - steps.mean(rows)).T / deviation
    cross = gain @ S
    mean = StateVector([v if a is None else a(v) for v, a in zip(expected.tolist(), seen.angles, strict=True)])
    covar = S if noisy else S - seen.R
    return MeasurementPrediction.from_state(
        predicted,
        mean,
        covar.view(CovarianceMatrix),
        cross_covar=cross.reshape(n, m).view(CovarianceMatrix),
        target_type=GaussianMeasurementPrediction,
    )


# Of what is plain nothing is asked further, which is most of the time that it takes.
_PLAIN = frozenset({float, int, bool, str, type(None)})


def _told(value: Any) -> Any:
    """All that a model was told, as something to compare with: models may be changed in place."""
    if isinstance(value, np.ndarray):
        return value.shape, (tuple(value.flat) if value.dtype.hasobject else value.tobytes())
    if isinstance(value, Base):
        value = value.__dict__.values()
    elif not isinstance(value, list | tuple):
        return value if isinstance(value, Hashable) else id(value)
    return tuple([one if type(one) in _PLAIN else _told(one) for one in value])


@lru_cache(maxsize=256)
def _seen(model: Any, told: Any) -> Seen:
    return sensor_of(model)


@lru_cache(maxsize=64)
def _compiled(filter: Filter, function: Any, R: bytes, angles: tuple[type | None, ...], n: int) -> RowSteps:
    m = len(angles)
    names = tuple(f"z{k}" if a is None else angle(f"z{k}") for k, a in enumerate(angles))
    noise = np.frombuffer(R).reshape(m, m)
    # Nothing ever moves by this motion.
    model = Model(motion=_still, Q=np.zeros(n), sensor=function, R=noise, state=_states(n), measurement=names)
    return RowSteps(filter, model)


def _steps(filter: Filter, model: Any, told: Any) -> tuple[RowSteps, Seen]:
    seen = _seen(model, told)
    return _compiled(filter, seen.function, seen.R.tobytes(), seen.angles, seen.size), seen


def _rows(steps: RowSteps, state: Any) -> np.ndarray:
    """The row of a state: the one it was computed as, with the factor it had, else one begun from its covariance."""
    kept = getattr(state, _ROW, None)
    if kept is not None and kept[0] == steps.filter and kept[1] is state.state_vector and kept[2] is state.covar:
        return kept[3]
    if not isinstance(state, GaussianState | SqrtGaussianState):
        raise InputError(
            f"a state must be Gaussian, by its covariance or its root; of a {type(state).__name__} with moments make "
            "GaussianState(state.mean, state.covar, timestamp=state.timestamp)"
        )
    mean = np.asarray(numbers("the mean of a state", state.state_vector), float).reshape(1, -1)
    cov = np.asarray(numbers("the covariance of a state", state.covar), float)[None]
    n = steps.packing.n
    if mean.shape != (1, n) or cov.shape != (1, n, n):
        raise InputError(f"the state has {mean.size} components, the model {n}")
    if not np.isfinite(mean).all() or not np.isfinite(cov).all():
        raise InputError("a state must be finite")
    if (cov.diagonal(axis1=1, axis2=2) < 0).any():
        raise InputError("the covariance of a state has a negative variance")
    rows = steps.start(mean, cov)
    scale = np.sqrt(cov[0].diagonal())
    # Only where its factor does not give it back is there something to find out, which takes longer.
    if (np.abs(steps.cov(rows) - cov) > 1e-6 * scale[:, None] * scale).any():
        symmetric_semidefinite("the covariance of a state", cov[0])
    return _remembered(steps, state, rows)


# Rows of one filter and size look alike, whatever the model.
_ROW = "_sigmax_row"


def _remembered(steps: RowSteps, state: Any, rows: np.ndarray) -> np.ndarray:
    setattr(state, _ROW, (steps.filter, state.state_vector, state.covar, rows))
    return rows


def _moments(steps: RowSteps, rows: np.ndarray, like: Any) -> tuple[StateVector, CovarianceMatrix]:
    """Mean and covariance of a row; the root of the covariance where the state that it comes from stores one."""
    mean = np.array(steps.mean(rows)[0]).reshape(-1, 1).view(StateVector)
    spread = steps.factor(rows) if isinstance(like, SqrtGaussianState) else steps.cov(rows)
    return mean, spread[0].view(CovarianceMatrix)


def _states(n: int) -> tuple[str, ...]:
    return tuple(f"x{k}" for k in range(n))


def _still(x: Any, dt: Any) -> Any:
    return x


def _first(x: Any) -> Any:
    return jnp.stack([x[0]])
