"""The studies that have a name."""

from collections.abc import Callable
from typing import Any, NamedTuple

from sigmax.studies.named import belov, classic, sobolev, stepanov, zhang


class Named(NamedTuple):
    """A study by name: how it is made, from which options, and what it is."""

    make: Callable[..., Any]
    about: str


NAMED: dict[str, Named] = {
    "sobolev-rmse": Named(sobolev.rmse, "fourteen filters on a radar target: errors over time (Sobolev, figure 3)"),
    "sobolev-spread": Named(sobolev.spread, "the same radar, the scaled transform from wide to narrow (figure 2)"),
    "sobolev-cost": Named(sobolev.cost, "the same radar, time of prediction and correction (figure 4)"),
    "stepanov-scalar": Named(stepanov.scalar, "four scalar problems, polynomial filters beside the optimum"),
    "single-beacon": Named(stepanov.single_beacon, "an underwater vehicle that ranges to one beacon"),
    "quadratic-vector": Named(stepanov.vector, "quadratic motion and sensor in several components"),
    "zhang-bearings": Named(zhang.bearings, "bearings with a random bias as printed (Zhang et al., section 4)"),
    "bearings-repaired": Named(zhang.repaired, "the same with a geometry that tells filters apart"),
    "radar-registration": Named(zhang.registration, "radars with offsets of their own: where two stages pay"),
    "belov-terrain": Named(belov.terrain, "an inertial system over real terrain, sigma sets permuted"),
    "growth": Named(classic.growth, "univariate nonstationary growth: the measurement does not tell ±x"),
    "reentry": Named(classic.reentry, "a vehicle enters the atmosphere, its drag unknown"),
    "bearings-only": Named(classic.bearings, "a target of which a moving platform sees the bearing only"),
}
