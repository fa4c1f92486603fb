"""What the numbers were measured on."""

import os
import platform
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("sigmax", "dynamax", "filterpy", "turbo-ckf", "stonesoup", "jax", "jaxlib", "numpy")


def processor() -> str:
    """The name of the processor, and what it can do with several numbers at once."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor() or platform.machine()
    fields = dict(line.split(":", 1) for line in info.read_text().split("\n\n")[0].splitlines() if ":" in line)
    found = {k.strip(): v.strip() for k, v in fields.items()}
    lanes = [name for name in ("avx512f", "avx2") if name in found.get("flags", "").split()][:1]
    clock = f"{float(found['cpu MHz']) / 1000:.1f} GHz" if "cpu MHz" in found else ""
    return ", ".join(part for part in (found.get("model name", platform.machine()), clock, *lanes) if part)


def description(load: float) -> list[tuple[str, str]]:
    """Rows of a table: machine, versions, date; `load` is the load average when the run began."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return [
        ("Processor", processor()),
        ("Cores", f"{cores} (load average {load:.1f} when the run began)"),
        ("System", f"{platform.system()} {platform.release()}"),
        ("Python", platform.python_version()),
        ("Libraries", ", ".join(f"{name} {installed(name) or 'not installed'}" for name in PACKAGES)),
        ("Date", date.today().isoformat()),
    ]


def installed(package: str) -> str | None:
    """The version of a package, None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        if package != "sigmax":
            return None
        import sigmax

        return sigmax.__version__
