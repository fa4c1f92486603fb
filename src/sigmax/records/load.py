"""Finding a record by its name or its description."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from sigmax.errors import InputError, unknown
from sigmax.files.plot_description import describes_plots
from sigmax.files.read_table import is_table
from sigmax.records.record import Record

# Whoever tracks no plots need not wait for the tracker.
if TYPE_CHECKING:
    from sigmax.records.plots import PlotRecord


class Builtin(NamedTuple):
    """A record that comes with the library: how to make it, and what it is."""

    make: Callable[[], Record]
    about: str


def _plaza(run: int) -> Callable[[], Record]:
    def make() -> Record:
        from sigmax.records.plaza import plaza

        return plaza(run)

    return make


def _jacksboro() -> Record:
    from sigmax.records.maps import elevation
    from sigmax.records.terrain import terrain

    return terrain(elevation("jacksboro"), "jacksboro")


def _kitti_imu() -> Record:
    from sigmax.records.kitti import kitti_imu

    return kitti_imu()


def builtin() -> dict[str, Builtin]:
    """The built-in records by name."""
    about = "a robot mower among four radio beacons: ranges and odometry, truth to centimetres (extra: plaza)"
    plazas = {f"plaza{run}": Builtin(_plaza(run), f"{about}, run {run}") for run in (1, 2)}
    flight = "terrain-aided navigation over the Jacksboro fault: real heights, a simulated flight"
    drive = "a car through streets: inertial sensors and satellite positions, with attitude (extra: plaza)"
    return plazas | {"jacksboro": Builtin(_jacksboro, flight), "kitti-imu": Builtin(_kitti_imu, drive)}


def load_plots(name: str, folder: Path | None = None) -> "PlotRecord | None":
    """A record of plots, "autoferry:N" with the folder of the data set, or a TOML file with a table [tracking].

    None for anything else.

    Raises:
        InputError: for whatever is missing or does not fit, before any long work.
    """
    if name.casefold().startswith("autoferry"):
        from sigmax.records.autoferry import autoferry

        return autoferry(name.partition(":")[2], folder)
    path = Path(name)
    if path.suffix.casefold() == ".toml" and describes_plots(path):
        from sigmax.records.own_plots import own_plots

        return own_plots(path)
    return None


def description_of(path: Path) -> Path:
    """Where the description of a file of data is best put."""
    return path.with_name(f"{path.name.split('.')[0] or 'data'}.toml")


def load(name: str) -> Record:
    """A built-in record by its name, or one of your own by the path of its TOML description.

    Raises:
        InputError: for whatever is missing or does not fit, before any filter runs.
    """
    known = builtin()
    if name.casefold() in known:
        return known[name.casefold()].make()
    path = Path(name)
    if path.suffix.casefold() == ".toml":
        from sigmax.records.own import own

        return own(path)
    if is_table(path):
        from sigmax.proposals.suggest import propose

        toml, remarks = propose(path)
        raise InputError(
            f"{path} holds data; sigmax tracks a short TOML file that says what they mean. Save this as "
            f"{description_of(path).name} beside it, correct it, and track that:\n\n{toml}\n" + "\n".join(remarks)
        )
    if path.exists():
        raise InputError(f"{path} is neither a built-in record ({', '.join(known)}) nor a .toml description")
    raise InputError(f"{unknown('record', name, known)}; or give the path of a .toml description")
