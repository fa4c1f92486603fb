"""Functions from a user's own file, written "file.py:function", and which files may be run."""

import shlex
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from sigmax.errors import InputError, unknown
from sigmax.ownership import stranger
from sigmax.tracing import Traceable, traceable

_allowed: list[Path] = []


def is_reference(kind: Any) -> bool:
    """Whether a text means a function in a file."""
    return isinstance(kind, str) and ".py:" in kind


@contextmanager
def functions_allowed_from(*folders: Path) -> Iterator[None]:
    """Within the block files of these folders may be run wherever a description lies, and whoever could write them."""
    _allowed.extend(folder.resolve() for folder in folders)
    try:
        yield
    finally:
        del _allowed[len(_allowed) - len(folders) :]


def check_runnable(path: Path, folder: Path | None, where: str) -> None:
    """Refuse a file that a description, or somebody else, could have slipped in.

    Args:
        path: the file.
        folder: that of the description which names it; None where the user named the file himself.
        where: the description names it.

    Raises:
        InputError: for a file outside of the folder of its description, links followed, or one that another user
            could have written.
    """
    real = path.resolve()
    if any(real.is_relative_to(place) for place in _allowed):
        return
    remedy = f"to allow it: sigmax --allow {shlex.quote(str(real.parent))} …"
    if folder is not None and not real.is_relative_to(folder.resolve()):
        raise InputError(
            f"{where}: {real} lies outside of {folder.resolve()}, where the description lies; only files there or "
            f"below are used; {remedy}"
        )
    if who := stranger(real):
        raise InputError(f"{where}: {path} is not run: {who}; change that with chown or chmod, or {remedy}")


class Functions:
    """Functions of files; each file is executed once.

    Args:
        folder: that of the description, to which paths are relative; files must lie there or below.
        named_by_user: the user named the file himself: it may lie anywhere.
    """

    def __init__(self, folder: Path, named_by_user: bool = False) -> None:
        self._folder, self._named_by_user = folder, named_by_user
        self._modules: dict[Path, ModuleType] = {}

    def __call__(self, reference: str, where: str) -> Callable[..., Any]:
        """The function that "file.py:function" means.

        Raises:
            InputError: where the file or the function does not exist, may not be run, or the file fails.
        """
        file, _, name = reference.rpartition(":")
        module = self._module(self._folder / file, where)
        known = [n for n, value in vars(module).items() if callable(value) and not n.startswith("_")]
        function = getattr(module, name, None)
        if not callable(function):
            raise InputError(f"{where}: {unknown(f'function of {file}', name, known)}")
        found: Callable[..., Any] = traceable(function)
        return found

    def _module(self, path: Path, where: str) -> ModuleType:
        if path in self._modules:
            return self._modules[path]
        if "\0" in str(path) or not path.is_file():
            raise InputError(f"{where}: there is no file {path}; paths are relative to the description")
        check_runnable(path, None if self._named_by_user else self._folder, where)
        module = ModuleType(f"sigmax_user_{path.stem}")
        module.__file__ = str(path)
        try:
            # Straight from the file: what lies compiled beside it could be of somebody else.
            exec(compile(path.read_bytes(), str(path), "exec"), module.__dict__)
        except SyntaxError as error:
            raise InputError(f"{where}: {path.name}, line {error.lineno}: {error.msg}") from error
        except OSError as error:
            raise InputError(f"{where}: {path} cannot be read: {error}") from error
        except (Exception, SystemExit) as error:
            raise _failed(f"{where}: {path.name}", error) from error
        self._modules[path] = module
        return module


def called(function: Callable[..., Any], where: str, **values: Any) -> Any:
    """What a user's function gives that makes a model or a study: it is called as it is, nothing in it is traced.

    Raises:
        InputError: where it fails, with the line.
    """
    try:
        return (function.function if isinstance(function, Traceable) else function)(**values)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise _failed(where, error) from error


def _failed(where: str, error: BaseException) -> InputError:
    line = traceback.extract_tb(error.__traceback__)[-1].lineno
    return InputError(f"{where} fails at line {line}: {type(error).__name__}: {error}")
