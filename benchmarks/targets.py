"""What was to be reached beside what was."""

import numpy as np

import yardsticks
from fresh import CACHED, Process
from measure import Spread, Timing, ratio, spread
from report import Section
from scenario import STEPS

Row = tuple[str, str, str, str]


def _at_least(goal: float, what: str, reached: Spread) -> Row:
    return what, f"{goal} × or more", f"{reached} ×", "reached" if reached.median >= goal else "missed"


def _at_most(goal: float, unit: str, what: str, reached: Spread) -> Row:
    return what, f"{goal} {unit} or less", f"{reached} {unit}", "reached" if reached.median <= goal else "missed"


def _races(results: dict[str, dict[str, Timing]]) -> list[Row]:
    step, live = "sigmax SRCKFB, step", "SRCKFB live step, mean and covariance read, faster than"
    means, alone = "sigmax SRCKFB, step, mean read alone", "SRCKFB live step, mean read alone, faster than"
    end, called = "sigmax SRCKFB, step, state read at the end", "SRCKFB live step, state read at the end, faster than"
    goals = [
        (2.5, "SRCKFB faster than dynamax's UKF, batch", "dynamax UKF", "sigmax SRCKFB", "batch"),
        (1.8, "EKF faster than dynamax's EKF, batch", "dynamax EKF", "sigmax EKF", "batch"),
        (15, f"{live} turbo-ckf CKF", "turbo-ckf CKF", step, "live"),
        (80, f"{live} FilterPy UKF", "FilterPy UKF", step, "live"),
        (15, f"{called} turbo-ckf CKF", "turbo-ckf CKF", end, "live"),
        (80, f"{called} FilterPy UKF", "FilterPy UKF", end, "live"),
        (250, f"{called} Stone Soup UKF", "Stone Soup UKF", end, "live"),
        (15, f"{alone} turbo-ckf CKF", "turbo-ckf CKF", means, "live"),
        (80, f"{alone} FilterPy UKF", "FilterPy UKF", means, "live"),
        (250, f"{alone} Stone Soup UKF", "Stone Soup UKF", means, "live"),
        (8, f"{live} FilterPy UKF, model on plain floats", "FilterPy UKF, model on plain floats", step, "live"),
        (250, f"{live} Stone Soup UKF", "Stone Soup UKF", step, "live"),
    ]
    return [
        _at_least(goal, what, ratio(results[discipline][other], results[discipline][own]))
        for goal, what, other, own, discipline in goals
        if other in results[discipline]
    ]


def _per_core(seconds: dict[str, np.ndarray]) -> list[Row]:
    lanes, unrolled = yardsticks.LANES, yardsticks.UNROLLED
    one, hybrid, unscented, ekf = (f"sigmax {name}" for name in ("SRCKFB", "SRECKFB", "SREUKFB", "EKF"))
    goals = [
        *((goal, own, yard) for yard in (lanes, unrolled) for goal, own in ((0.8, one), (0.5, hybrid), (0.4, ekf))),
        (1.15, unscented, hybrid),
        (1.6, hybrid, ekf),
    ]
    rows = [
        _at_most(goal, "×", f"{own} in the time of {other}, one core", spread(seconds[own] / seconds[other]))
        for goal, own, other in goals
        if own in seconds and other in seconds
    ]
    faster = [
        (7, f"SRCKFB faster than {yardsticks.EIGEN}, one core", yardsticks.EIGEN, one),
        (1.8, "SRCKFB on two cores faster than on one", one, yardsticks.TWO_CORES),
    ]
    rows += [
        _at_least(goal, what, spread(seconds[other] / seconds[own]))
        for goal, what, other, own in faster
        if own in seconds and other in seconds
    ]
    if yardsticks.LIVE in seconds:
        step = spread(seconds[yardsticks.LIVE] * 1e6 / STEPS)
        rows.append(_at_most(6, "µs", "SRCKFB live step, the call from Python alone", step))
    return rows


def _processes(processes: dict[str, Process], help_seconds: np.ndarray | None) -> list[Row]:
    def making(name: str) -> Spread:
        return spread(np.array([told["first run"] - told["second run"] for told in processes[name].told]))

    rows = [
        _at_most(3.0, "s", "Lower and compile one filter (SRCKFB, fresh process, empty cache)", making("sigmax")),
        _at_most(0.05, "s", "The same from the cache", making(CACHED)),
    ]
    if help_seconds is None:
        return [*rows, ("sigmax --help, whole process", "0.4 s or less", "no command line here", "not measured")]
    return [*rows, _at_most(0.4, "s", "sigmax --help, whole process", spread(help_seconds))]


def targets(
    results: dict[str, dict[str, Timing]],
    per_core: dict[str, np.ndarray],
    processes: dict[str, Process],
    help_seconds: np.ndarray | None,
) -> Section:
    """All targets; a target whose contender is not there is left out."""
    rows: list[tuple[str, ...]] = [*_races(results), *_per_core(per_core), *_processes(processes, help_seconds)]
    return Section("Targets", "Missed is missed on this machine, in this run.", ("", "target", "measured", ""), rows)
